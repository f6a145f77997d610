"""What one update learns from."""

from collections.abc import Callable
from typing import NamedTuple

from torch import Tensor

from eia_sec.learner.networks.sequences import TypeSequences


class Minibatch(NamedTuple):
    """Rows of an iteration, and the schedules' present values.

    Attributes:
        own: returns a type's observations [B, n, o] by the type's index. A task on a processor draws its own with it,
            so that they are in its cache.
        tensors: actions, log-probabilities, advantages and returns of its rows.
        team: [B, O] observations of all agents, or [B, 0] where no value function sees them.
        sequences: how networks with memory go through it, else None.
        stopped: of each type, whether its actors have stopped.
        entropy_weight: w_H of a type whose scale is 1; a tensor [] in a CUDA graph, as is the next.
        rate_share: share of the learning rates.
    """

    own: Callable[[int], Tensor]
    tensors: dict[str, Tensor]
    team: Tensor
    sequences: TypeSequences | None
    stopped: tuple[bool, ...]
    entropy_weight: float | Tensor
    rate_share: float | Tensor
