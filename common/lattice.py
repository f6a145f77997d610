"""From an actor's output to a velocity by way of the places of a lattice.

An actor that steers by a lattice says with each of its two numbers whether to go back, stay or go on along x and y, and
flies to the place next to it that this names. Gaussian noise on an output, in training or in its weights, then changes
nothing until it crosses a third of the range, and what was flown last is no longer summed up into a drift. The paper's
actors command velocities; see docs/explanation/method.md for what this changes.

Source: an actor's output mapped to the nearest of the possible actions, Dulac-Arnold et al. (2015), Deep reinforcement
learning in large discrete action spaces.
"""

import math
import sys
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from common.config.checks import within
from common.errors import ConfigError

Float32 = NDArray[np.float32]

GAIN: Final = 1.5
"""An output beyond half of 1 / GAIN, a third, leads to the next place."""
EDGE: Final = 1e-4
"""A UAV that is so little short of the next cell, as a share of a cell, is taken to be in it."""


@dataclass(frozen=True)
class Lattice:
    """Places spread evenly over the field, one in the middle of each cell, neighbours at most one step apart.

    Attributes:
        columns: places along x.
        rows: places along y.
        reach_x: what full speed along x covers in a step, as a share of the field's width.
        reach_y: the same along y, of its depth.
    """

    columns: int
    rows: int
    reach_x: float
    reach_y: float

    def __post_init__(self) -> None:
        """Refuse lattices without places and UAVs that do not move."""
        within(1, 2**20, columns=self.columns, rows=self.rows)
        for reach in (self.reach_x, self.reach_y):
            if not 0.0 < reach < math.inf:
                raise ConfigError(f"a lattice's reach must be positive and finite, not {reach}.")

    @classmethod
    def spanning(cls, reach_x: float, reach_y: float) -> "Lattice":
        """Return the lattice with the fewest places whose neighbours are within reach of each other."""
        return cls(fewest(reach_x), fewest(reach_y), reach_x, reach_y)

    def steer(self, place: Float32, action: Float32) -> Float32:
        """Return the velocities that lead to the places that actions name.

        Args:
            place: [..., 2] float32, where the UAVs are, the field from -1 to 1.
            action: [..., 2] float32 in [-1, 1].

        Returns:
            [..., 2] float32 in [-1, 1], full speed being 1. Nobody is sent beyond the outermost places.
        """
        count = np.array([self.columns, self.rows], np.float32)
        reach = np.array([self.reach_x, self.reach_y], np.float32)
        last = count - np.float32(1)
        share = (place + np.float32(1)) * np.float32(0.5)
        cell = np.clip(np.floor(share * count + np.float32(EDGE)), 0, last)
        step = np.clip(np.rint(np.float32(GAIN) * action), -1, 1)
        goal = (np.clip(cell + step, 0, last) + np.float32(0.5)) / count
        velocity: Float32 = np.clip((goal - share) / reach, np.float32(-1), np.float32(1))
        return velocity

    def to_list(self) -> list[float]:
        """Return a plain description for the wire and for files."""
        return [self.columns, self.rows, self.reach_x, self.reach_y]

    @classmethod
    def from_list(cls, data: Any) -> "Lattice":
        """Rebuild a lattice from `to_list`; raise TypeError, ValueError or ConfigError when it is none."""
        columns, rows, reach_x, reach_y = data
        return cls(int(columns), int(rows), float(reach_x), float(reach_y))


def fewest(reach: float) -> int:
    """Return how many cells of at most `reach`, a share of the field, fill the field.

    Raises:
        ConfigError: they cannot be counted.
    """
    if reach * sys.float_info.max <= 1.0:
        raise ConfigError("a step at full speed is too small a share of the field to be computed with.")
    return max(1, math.ceil(1.0 / reach - 1e-9))
