"""The set of places in a ring that may be drawn: uniform draws, additions and removals without a loop over places."""

import numpy as np
from numpy.typing import NDArray

from common.errors import CheckpointError
from learner.data import replay_kernels

Places = NDArray[np.int64]


class IndexSet:
    """A subset of the places 0 .. capacity - 1, held compactly, so that a draw is one index into an array.

    What is removed leaves a hole, which the last place of the array fills; the order is a function of the calls alone.

    Args:
        capacity: number of places.

    Attributes:
        count: places in the set.
    """

    def __init__(self, capacity: int) -> None:
        self._places: Places = np.zeros(capacity, np.int64)
        self._slot: Places = np.full(capacity, -1, np.int64)
        self.count = 0

    def remove(self, places: Places) -> int:
        """Take out those of the places that are in the set; return how many were."""
        left = replay_kernels.take_out(self._places, self._slot, self.count, places)
        taken, self.count = self.count - left, left
        return taken

    def exchange(self, gone: Places, new: Places) -> None:
        """Take out those of some places that are in the set, then put in others, each once and none of them in it."""
        self.count = replay_kernels.exchange(self._places, self._slot, self.count, gone, new)

    def draw(self, count: int, generator: np.random.Generator) -> Places:
        """Return `count` places, drawn uniformly with replacement; the set must not be empty."""
        return self._places[generator.integers(0, self.count, size=count)]

    def members(self) -> Places:
        """Return a copy of all places in the set, in the order that `restore` needs."""
        return self._places[: self.count].copy()

    def restore(self, members: Places) -> None:
        """Continue from `members`.

        Raises:
            CheckpointError: when they are not different places of this set.
        """
        capacity = self._places.shape[0]
        if members.ndim != 1 or members.shape[0] > capacity or (members < 0).any() or (members >= capacity).any():
            raise CheckpointError("the places that may be drawn do not fit the replay buffer.")
        slot = np.full(capacity, -1, np.int64)
        slot[members] = np.arange(members.shape[0])
        if np.count_nonzero(slot >= 0) != members.shape[0]:
            raise CheckpointError("a place of the replay buffer may be drawn twice.")
        self._slot = slot
        self._places[: members.shape[0]] = members
        self.count = members.shape[0]
