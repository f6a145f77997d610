"""Flight to boxes: a box is the lowest and the highest corner of a part of the field."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import WorldConfig

Array = NDArray[np.float64]

ROUNDING: Final = 1e-2
"""A UAV has reached a box if it is this close, m, because actions are rounded to float32."""
SLOWEST: Final = 0.05
"""Least speed against a wind that ways are reckoned with, over top speed; a stronger wind makes UAVs drift."""


def reach(world: WorldConfig) -> Array:
    """Return how far a UAV gets in one step along x and y, [2] m."""
    return np.array([world.speed_x_max, world.speed_y_max]) * world.step_seconds


def possible(wind: Array) -> tuple[Array, Array]:
    """Return the least and the largest action along each axis that the top airspeed allows in a wind over top speed."""
    return np.maximum(-1.0, wind - 1.0), np.minimum(1.0, wind + 1.0)


def ways(world: WorldConfig, wind: Array | None) -> tuple[Array, Array]:
    """Return how far a UAV gets in one step back and on along x and y, [2] m each, in a wind [2] over top speed."""
    if wind is None:
        return reach(world), reach(world)
    low, high = possible(wind)
    return np.maximum(-low, SLOWEST) * reach(world), np.maximum(high, SLOWEST) * reach(world)


def steps_to(position: Array, box: Array, world: WorldConfig, wind: Array | None = None) -> Array:
    """Return the fewest steps in which a UAV can reach a box, at least 1: [...]; in wind, as if it went on."""
    back, on = ways(world, wind)
    gap = np.maximum((box[0] - position - ROUNDING) / on, (position - box[1] - ROUNDING) / back)
    steps: Array = np.maximum(1.0, np.ceil(gap.max(axis=-1)))
    return steps


def aim(position: Array, box: Array, onward: Array, world: WorldConfig, wind: Array | None = None) -> Array:
    """Return the place in a box that is reached in the fewest steps. Ties go to the place nearest to the next box.

    Each axis has its own speed limit, so the axes are independent.

    Args:
        position: [..., 2] m.
        box: lowest and highest corner, [2, ..., 2] m.
        onward: the corners of the next box, [2, ..., 2] m.
        world: geometry and speeds.
        wind: [2] over top speed, or None.

    Returns:
        [..., 2] m.
    """
    back, on = ways(world, wind)
    steps = steps_to(position, box, world, wind)[..., None]
    then = np.clip(position, onward[0], onward[1])
    place: Array = np.clip(then, np.maximum(box[0], position - steps * back), np.minimum(box[1], position + steps * on))
    return place


def inside(position: Array, box: Array) -> NDArray[np.bool_]:
    """Return whether places [..., 2] lie in boxes [2, ..., 2]."""
    within: NDArray[np.bool_] = ((position >= box[0] - ROUNDING) & (position <= box[1] + ROUNDING)).all(axis=-1)
    return within
