"""A set of indices into a ring, with uniform draws, additions and removals in time independent of its size."""

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.errors import CheckpointError
from eia_sec.learner.off_policy import replay_kernels

Places = NDArray[np.int64]


class IndexSet:
    """A subset of 0 .. capacity - 1 in a compact array, so that a draw is one lookup.

    When an index is removed, the last one in the array takes its slot. The order depends only on the calls.

    Args:
        capacity: number of possible indices.

    Attributes:
        count: indices in the set.
    """

    def __init__(self, capacity: int) -> None:
        self._places: Places = np.zeros(capacity, np.int64)
        self._slot: Places = np.full(capacity, -1, np.int64)
        self.count = 0

    def remove(self, places: Places) -> int:
        """Remove those of the given indices that are in the set; return how many were."""
        left = replay_kernels.take_out(self._places, self._slot, self.count, places)
        taken, self.count = self.count - left, left
        return taken

    def exchange(self, gone: Places, new: Places) -> None:
        """Remove those of `gone` that are in the set, then add `new`, which must be distinct and not in it."""
        self.count = replay_kernels.exchange(self._places, self._slot, self.count, gone, new)

    def draw(self, count: int, generator: np.random.Generator) -> Places:
        """Return `count` indices, drawn uniformly with replacement; the set must not be empty."""
        return self._places[generator.integers(0, self.count, size=count)]

    def members(self) -> Places:
        """Return a copy of all indices in the set, in the order that `restore` needs."""
        return self._places[: self.count].copy()

    def restore(self, members: Places) -> None:
        """Continue from `members`.

        Raises:
            CheckpointError: when they are not distinct indices below the capacity.
        """
        capacity = self._places.shape[0]
        if members.ndim != 1 or members.shape[0] > capacity or (members < 0).any() or (members >= capacity).any():
            raise CheckpointError("the drawable rows do not fit the replay buffer.")
        slot = np.full(capacity, -1, np.int64)
        slot[members] = np.arange(members.shape[0])
        if np.count_nonzero(slot >= 0) != members.shape[0]:
            raise CheckpointError("the replay buffer lists a drawable row twice.")
        self._slot = slot
        self._places[: members.shape[0]] = members
        self.count = members.shape[0]
