"""MAPPO (Yu et al. 2022): PPO with a value function of the observations of all agents, V_i(o_1, ..., o_n)."""

import math

import torch
from torch import Tensor

from eia_sec.common.config import OnPolicyConfig
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.learner.networks.recurrent import make_stack
from eia_sec.learner.networks.sequences import Sequences, Unroll
from eia_sec.learner.on_policy.experience import split
from eia_sec.learner.on_policy.ppo import Ppo
from eia_sec.learner.on_policy.values import GroupValue


def joined_images(team: TeamSpec, rows: Tensor) -> Tensor:
    """Return rows [B, O] as images row by row, [B, H W C], with the channels of all agents one after another."""
    parts = []
    for group, own in zip(team.groups, split(team, rows), strict=True):
        pixels = own[..., : math.prod(group.image)]
        parts.append(pixels.reshape(len(rows), group.count, -1, group.image[2]).transpose(1, 2).flatten(2))
    return torch.cat(parts, dim=2).flatten(1)


class TeamValue(GroupValue):
    """V of the observations of all agents: one network with an output for each agent of the type."""

    def __init__(self, config: OnPolicyConfig, team: TeamSpec, group: GroupSpec, seed: int) -> None:
        super().__init__()
        names = [(seed, "team value", group.name, 0)]
        self._team = team if any(group.image for group in team.groups) else None
        self.network = make_stack(config, 1, team.seen, group.count, 1.0, names)
        self.states = 1

    def value(self, team: Tensor, own: Tensor, sequences: Sequences | None = None) -> Tensor:
        """Return V [B, n]."""
        seen = team if self._team is None else joined_images(self._team, team)
        found: Tensor = self.network(seen[:, None], sequences).squeeze(1)
        return found

    def unroll(self, team: Tensor, own: Tensor, sequences: Sequences) -> Unroll:
        """Return V and the states after each row."""
        found = self.network.unroll(team[:, None], sequences)
        return Unroll(found.outputs.squeeze(1), found.state)


class Mappo(Ppo):
    """MAPPO."""

    def value_function(self, group: GroupSpec, seed: int) -> GroupValue:
        """See `Ppo`."""
        return TeamValue(self.config, self.team, group, seed)
