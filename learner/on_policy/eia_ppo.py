"""EIA-SEC on policy: PPO with a local value function for each agent, mixed with an ensemble that its type shares.

    V_P,i = eps V_i(o_i) + (1 - eps) mean_k V_s,k(o_i)

is the mixture of eq. (value) with values in place of Q. Every network regresses to the return by itself (A7), and the
loss is the sum of all. Of a minibatch's rows, or sequences, each of the k_s members learns from every k_s-th, so that
members differ, and all of them together take as long as one network. While the agents of a type share an actor there
are no local value functions: V_P,i is the ensemble's mean, and at the parting every V_i begins as its first member. The
method's other half, elite imitation, acts on the actors between iterations.
"""

from collections.abc import Iterator, Sequence

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
    """V_P,i: an ensemble that the type shares, mixed with a local value function for each agent that has an actor."""

    def __init__(self, config: OnPolicyConfig, group: GroupSpec, seed: int) -> None:
        super().__init__()
        self._weight, self._agents = config.local_weight, group.count
        self.local = None if config.shared else OwnValue(config, group, seed)
        self.members = nn.ModuleList(
            make_stack(config, 1, group.seen, 1, 1.0, [(seed, "member", group.name, index)])
            for index in range(config.ensemble_size)
        )
        self.states = group.count * (len(self.members) + (self.local is not None))

    def _parts(self, sequences: Sequences | None) -> list[Sequences | None]:
        """Return the sequences with the states of each network: the members, then the local ones."""
        starts = range(0, self.states, self._agents)
        return [None if sequences is None else sequences.of(slice(s, s + self._agents)) for s in starts]

    def _mixed(self, members: Sequence[Tensor], local: Tensor | None) -> Tensor:
        shared = torch.stack([*members]).mean(dim=0)
        return shared if local is None else self._weight * local + (1.0 - self._weight) * shared

    def value(self, team: Tensor, own: Tensor, sequences: Sequences | None = None) -> Tensor:
        """Return V_P [B, n]."""
        parts = self._parts(sequences)
        members = [member(own, part).squeeze(-1) for member, part in zip(self.members, parts, strict=False)]
        return self._mixed(members, None if self.local is None else self.local.value(team, own, parts[-1]))

    def unroll(self, team: Tensor, own: Tensor, sequences: Sequences) -> Unroll:
        """Return V_P and the states after each row."""
        parts = [part for part in self._parts(sequences) if part is not None]
        found = [_stack(member).unroll(own, part) for member, part in zip(self.members, parts, strict=False)]
        members, states = [each.outputs.squeeze(-1) for each in found], [each.state for each in found]
        if self.local is None:
            return Unroll(self._mixed(members, None), torch.cat(states, dim=1))
        local = self.local.unroll(team, own, parts[-1])
        return Unroll(self._mixed(members, local.outputs), torch.cat([*states, local.state], dim=1))

    def loss(self, team: Tensor, own: Tensor, returns: Tensor, sequences: Sequences | None = None) -> Tensor:
        """Return the sum of all networks' losses; each member learns from its share of the rows."""
        parts = self._parts(sequences)
        losses = [] if self.local is None else [self.local.loss(team, own, returns, parts[-1])]
        for index, (member, part) in enumerate(zip(self.members, parts, strict=False)):
            seen, wanted, shared = _share(index, len(self.members), own, returns, part)
            losses.append((member(seen, shared).squeeze(-1) - wanted).square().mean())
        return torch.stack(losses).sum()

    def rows_learnt(self, rows: int) -> Iterator[tuple[nn.Parameter, int]]:
        """See `GroupValue`; without memory a member learns from every k_s-th row."""
        if self.local is not None:
            yield from self.local.rows_learnt(rows)
        for index, member in enumerate(self.members):
            own = len(range(index % max(1, rows), rows, len(self.members)))
            yield from ((parameter, own) for parameter in member.parameters())


def _share(
    index: int, count: int, own: Tensor, returns: Tensor, sequences: Sequences | None
) -> tuple[Tensor, Tensor, Sequences | None]:
    """Return what one of `count` members learns from: every count-th row, or with memory every count-th sequence.

    Args:
        index: the member's.
        count: k_s. Of fewer rows than members, several members learn from one.
        own: observations [B, n, o], or [L B, n, o] of B sequences.
        returns: [B, n] or [L B, n].
        sequences: how the rows follow one another.
    """
    if sequences is None:
        rows = slice(index % len(own), None, count)
        return own[rows], returns[rows], None
    length, among = sequences.keep.shape
    chosen = slice(index % among, None, count)
    seen, wanted = (tensor.unflatten(0, (length, among))[:, chosen].flatten(0, 1) for tensor in (own, returns))
    return seen, wanted, Sequences(sequences.keep[:, chosen], sequences.state[chosen])


class EiaPpo(Ppo):
    """EIA-SEC on policy."""

    def value_function(self, group: GroupSpec, seed: int) -> GroupValue:
        """See `Ppo`; without members, the local value function alone."""
        kind = MixedValue if self.config.ensemble_size else OwnValue
        return kind(self.config, group, seed)

    def shared_name(self, name: str) -> str:
        """See `Ppo`; local value functions begin as the first member of the ensemble."""
        return name.replace(".local.network.", ".members.0.")


def _stack(module: nn.Module) -> Stack:
    assert isinstance(module, Stack)
    return module
