"""EIA-SEC on policy: PPO with a local value function for each agent, mixed with an ensemble that its type shares.

    V_P,i = eps V_i(o_i) + (1 - eps) mean_k V_s,k(o_i)

is the mixture of eq. (value) with values in place of Q. Every network regresses to the return by itself (A7), and the
loss is the sum of all. The method's other half, elite imitation, acts on the actors between iterations.
"""

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from eia_sec.common.config import OnPolicyConfig
from eia_sec.common.team import GroupSpec
from eia_sec.learner.networks.recurrent import make_stack
from eia_sec.learner.networks.sequences import Sequences, Unroll
from eia_sec.learner.networks.stack import Stack
from eia_sec.learner.on_policy.ippo import OwnValue
from eia_sec.learner.on_policy.ppo import Ppo
from eia_sec.learner.on_policy.values import GroupValue


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


class EiaPpo(Ppo):
    """EIA-SEC on policy."""

    def value_function(self, group: GroupSpec, seed: int) -> GroupValue:
        """See `Ppo`; without members, the local value function alone."""
        kind = MixedValue if self.config.ensemble_size else OwnValue
        return kind(self.config, group, seed)


def _stack(module: nn.Module) -> Stack:
    assert isinstance(module, Stack)
    return module
