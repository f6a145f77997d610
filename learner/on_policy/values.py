"""The interface of the value functions of one type's agents.

Every network regresses to the return by itself (A7): L = mean((V - R)^2), over a batch and the agents.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator

from torch import Tensor, nn

from eia_sec.learner.networks.sequences import Sequences, Unroll


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

    def rows_learnt(self, rows: int) -> Iterator[tuple[nn.Parameter, int]]:
        """Yield each parameter, and how many of a minibatch's rows its gradient is a mean over."""
        yield from ((parameter, rows) for parameter in self.parameters())
