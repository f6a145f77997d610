"""Sequences: how networks with memory go through an iteration's steps.

Rows hold equally many steps of E environments (`eia_sec.common.transitions.Rows`). These are cut into sequences of L
steps: number b E + e holds the steps b L to (b + 1) L - 1 of environment e. Gradients flow back to a sequence's
beginning and no further. Where an episode begins inside a sequence, the state is set to 0, which cuts it there.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from eia_sec.common.transitions import TRANSITION, Rows

LARGEST_BATCH = 4096
"""Rows that networks go through at once without gradients."""


class Sequences(NamedTuple):
    """B sequences of L rows in order of time: row l B + b of a batch is row l of sequence b.

    Attributes:
        keep: [L, B] float32, 0 where an episode begins with the row, else 1.
        state: [B, n, h] state of n networks before the first row.
    """

    keep: Tensor
    state: Tensor

    def of(self, networks: slice) -> "Sequences":
        """Return the same sequences for some of the networks."""
        return Sequences(self.keep, self.state[:, networks])


TypeSequences = list[tuple[Sequences, Sequences]]
"""For each type how its actors and its value functions go through some rows."""


class SequenceLayout:
    """Where an iteration's sequences are in its rows.

    Args:
        rows: rows of environments whose number of steps is a multiple of `length`.
        length: L.

    Attributes:
        environments: E.
        count: N, the number of sequences.
        rows: [L, N] row of each step.
        keep: [L, N] float32, 0 where an episode begins with the step, else 1.
    """

    def __init__(self, rows: Rows, length: int) -> None:
        steps = rows.steps_by_environment()
        total, self.environments = steps.shape
        self.count = total // length * self.environments
        goes_on = (rows.flag[steps - 1] & TRANSITION) > 0
        goes_on[0] = True  # from the state that the rows state, which is 0 if an episode begins

        def cut(array: NDArray[np.generic]) -> NDArray[np.generic]:
            blocks = array.reshape(-1, length, self.environments)
            return np.ascontiguousarray(blocks.transpose(1, 0, 2).reshape(length, self.count))

        self.rows: NDArray[np.int64] = cut(steps).astype(np.int64)
        self.keep = cut(goes_on).astype(np.float32)

    def in_order(self) -> Iterator[tuple[NDArray[np.int64], list[NDArray[np.int64]]]]:
        """Yield groups of environments, and the numbers of their sequences, block after block in order of time."""
        starts = np.arange(0, self.count, self.environments)
        groups = max(1, self.environments * len(self.rows) // LARGEST_BATCH)
        for group in np.array_split(np.arange(self.environments), min(groups, self.environments)):
            yield group, [start + group for start in starts]


class Unroll(NamedTuple):
    """What networks with memory return.

    Attributes:
        outputs: [L B, n, outputs].
        state: [L B, n, h] states after each row.
    """

    outputs: Tensor
    state: Tensor
