"""Random numbers for the actions of a batch of environments."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.seeds import stream
from eia_sec.common.team import Float32

BLOCK: Final = 128
"""Steps for which random numbers are drawn at once."""


class RandomRows:
    """Random numbers for every step of an episode, independent across episodes and steps."""

    def __init__(self, name: tuple[Any, ...], count: int, size: int) -> None:
        self._name = name
        self._rows = np.zeros((count, BLOCK, size), np.float32)
        self._held: NDArray[np.int64] = np.full((count, 2), -1, np.int64)
        self._index = np.arange(count)

    def at(self, episode: NDArray[np.int64], time: NDArray[np.int64], *, normal: bool) -> Float32:
        """Return one row for each environment: standard normal, or uniform over [0, 1)."""
        wanted = np.stack([episode, time // BLOCK], axis=1)
        for index in np.flatnonzero((wanted != self._held).any(axis=1)):
            generator = stream(*self._name, int(index), *wanted[index].tolist())
            shape = self._rows[index].shape
            drawn = generator.standard_normal(shape, np.float32) if normal else generator.random(shape, np.float32)
            self._rows[index] = drawn
        self._held = wanted
        found: Float32 = self._rows[self._index, time % BLOCK]
        return found
