"""The value functions of all types, and their losses.

A type's value is, by algorithm,

    ippo      V_i(o_i): of the agent's own observation
    mappo     V_i(o_1, ..., o_n): of the observations of all agents
    eia-ppo   V_P,i = eps V_i(o_i) + (1 - eps) mean_k V_s,k(o_i), the mixture of eq. (value) with values in place of Q

Every network regresses to the return by itself (A7): L = mean((V - R)^2), over a batch and the agents; each member of
the ensemble adds its own.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import torch
from torch import Tensor, nn

from eia_sec.common.config import OnPolicyConfig
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.learner.on_policy.networks import Stack
from eia_sec.learner.on_policy.policies import initialisation_names
from eia_sec.learner.on_policy.recurrent import make_stack
from eia_sec.learner.on_policy.sequences import Sequences, Unroll


class GroupValue(nn.Module, ABC):
    """The value functions of one type's agents.

    Attributes:
        states: K, how many states of networks with memory belong to one row.
    """

    states: int

    @abstractmethod
    def value(self, team: Tensor, own: Tensor, sequences: Sequences | None = None) -> Tensor:
        """Return V [B, n].

        Args:
            team: rows [B, O] of all agents' observations.
            own: [B, n, o] the type's observations.
            sequences: how the rows follow one another, with K states, for networks with memory.
        """

    @abstractmethod
    def unroll(self, team: Tensor, own: Tensor, sequences: Sequences) -> Unroll:
        """Return V [L B, n] and the states [L B, K, h] after each row, of networks with memory."""

    def loss(self, team: Tensor, own: Tensor, returns: Tensor, sequences: Sequences | None = None) -> Tensor:
        """Return mean((V - R)^2) against the returns [B, n]."""
        return (self.value(team, own, sequences) - returns).square().mean()


class OwnValue(GroupValue):
    """V_i(o_i), one network for the type or one for each agent."""

    def __init__(self, config: OnPolicyConfig, group: GroupSpec, seed: int) -> None:
        super().__init__()
        count = 1 if config.parameters == "shared" else group.count
        names = initialisation_names("value", group, count, seed, per_type=config.initialisation == "type")
        self.network = make_stack(config, count, group.observation_size, 1, 1.0, names)
        self.states = group.count

    def value(self, team: Tensor, own: Tensor, sequences: Sequences | None = None) -> Tensor:
        """Return V [B, n]."""
        found: Tensor = self.network(own, sequences).squeeze(-1)
        return found

    def unroll(self, team: Tensor, own: Tensor, sequences: Sequences) -> Unroll:
        """Return V and the states after each row."""
        found = self.network.unroll(own, sequences)
        return Unroll(found.outputs.squeeze(-1), found.state)


class TeamValue(GroupValue):
    """V of the observations of all agents: one network with an output for each agent of the type."""

    def __init__(self, config: OnPolicyConfig, team: TeamSpec, group: GroupSpec, seed: int) -> None:
        super().__init__()
        names = [(seed, "team value", group.name, 0)]
        self.network = make_stack(config, 1, team.observation_size, group.count, 1.0, names)
        self.states = 1

    def value(self, team: Tensor, own: Tensor, sequences: Sequences | None = None) -> Tensor:
        """Return V [B, n]."""
        found: Tensor = self.network(team[:, None], sequences).squeeze(1)
        return found

    def unroll(self, team: Tensor, own: Tensor, sequences: Sequences) -> Unroll:
        """Return V and the states after each row."""
        found = self.network.unroll(team[:, None], sequences)
        return Unroll(found.outputs.squeeze(1), found.state)


class MixedValue(GroupValue):
    """V_P,i: a local value function for each agent, mixed with an ensemble that the type shares."""

    def __init__(self, config: OnPolicyConfig, group: GroupSpec, seed: int) -> None:
        super().__init__()
        self._weight, self._agents = config.local_weight, group.count
        self.local = OwnValue(config, group, seed)
        self.members = nn.ModuleList(
            make_stack(config, 1, group.observation_size, 1, 1.0, [(seed, "member", group.name, index)])
            for index in range(config.ensemble_size)
        )
        self.states = group.count * (1 + config.ensemble_size)

    def _parts(self, sequences: Sequences | None) -> list[Sequences | None]:
        """Return the sequences with the states of the local networks, and with those of each member."""
        starts = range(0, self.states, self._agents)
        return [None if sequences is None else sequences.of(slice(s, s + self._agents)) for s in starts]

    def _mixed(self, local: Tensor, members: Sequence[Tensor]) -> Tensor:
        return self._weight * local + (1.0 - self._weight) * torch.stack([*members]).mean(dim=0)

    def value(self, team: Tensor, own: Tensor, sequences: Sequences | None = None) -> Tensor:
        """Return V_P [B, n]."""
        first, *rest = self._parts(sequences)
        local = self.local.value(team, own, first)
        members = [member(own, part).squeeze(-1) for member, part in zip(self.members, rest, strict=True)]
        return self._mixed(local, members)

    def unroll(self, team: Tensor, own: Tensor, sequences: Sequences) -> Unroll:
        """Return V_P and the states after each row."""
        first, *rest = (part for part in self._parts(sequences) if part is not None)
        local = self.local.unroll(team, own, first)
        members = [_stack(member).unroll(own, part) for member, part in zip(self.members, rest, strict=True)]
        mixed = self._mixed(local.outputs, [found.outputs.squeeze(-1) for found in members])
        return Unroll(mixed, torch.cat([local.state, *(found.state for found in members)], dim=1))

    def loss(self, team: Tensor, own: Tensor, returns: Tensor, sequences: Sequences | None = None) -> Tensor:
        """Return the sum of all networks' losses."""
        first, *rest = self._parts(sequences)
        both = zip(self.members, rest, strict=True)
        losses = [(member(own, part).squeeze(-1) - returns).square().mean() for member, part in both]
        return torch.stack([self.local.loss(team, own, returns, first), *losses]).sum()


def _stack(module: nn.Module) -> Stack:
    assert isinstance(module, Stack)
    return module


def make_values(config: OnPolicyConfig, team: TeamSpec, seed: int) -> list[GroupValue]:
    """Return the value functions of each type that the algorithm asks for."""
    if config.sees_team:
        return [TeamValue(config, team, group, seed) for group in team.groups]
    if config.ensemble_size:
        return [MixedValue(config, group, seed) for group in team.groups]
    return [OwnValue(config, group, seed) for group in team.groups]
