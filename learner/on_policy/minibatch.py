"""What one update learns from."""

from collections.abc import Callable
from typing import NamedTuple

from torch import Tensor

from learner.on_policy.sequences import TypeSequences


class Minibatch(NamedTuple):
    """Rows of an iteration, and the schedules' present values.

    Attributes:
        own: draws a type's observations [B, n, o] by the type's index; a task draws its own, so that they are in its
            cache.
        tensors: actions, log-probabilities, advantages and returns of its rows.
        team: [B, O] observations of all agents, or [B, 0] where no value function sees them.
        sequences: how networks with memory go through it, else None.
        entropy_weight: w_H of a type whose scale is 1.
        rate_share: share of the learning rates.
    """

    own: Callable[[int], Tensor]
    tensors: dict[str, Tensor]
    team: Tensor
    sequences: TypeSequences | None
    entropy_weight: float | Tensor
    rate_share: float | Tensor
