"""What the heuristics share: flying to a point, keeping apart, and the relays' place.

Actions are velocities as shares of the largest speed along each axis, so a step moves a UAV by
action * (V_x-max, V_y-max) * t_step.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from common.config import WorldConfig
from rollout.farms import FarmBatch

Array = NDArray[np.float64]

STANDOFF: Final = 1e-9
"""Least distance by which a direction is divided, m."""
EDGE: Final = 1e-3
"""Nobody flies nearer to the field's edge, m, so that rounding puts nobody out of range."""


def reach(world: WorldConfig) -> Array:
    """Return how far a UAV gets in one step along x and y, [2] m."""
    return np.array([world.speed_x_max, world.speed_y_max]) * world.step_seconds


def towards(position: Array, target: Array, world: WorldConfig) -> Array:
    """Return the action that flies straight to a target, at full speed until it can be reached in one step.

    Args:
        position: [..., 2] m.
        target: [..., 2] m.
        world: geometry and speeds.

    Returns:
        [..., 2] in [-1, 1].
    """
    share = (target - position) / reach(world)
    action: Array = share / np.maximum(1.0, np.abs(share).max(axis=-1, keepdims=True))
    return action


def keep_apart(position: Array, action: Array, world: WorldConfig) -> Array:
    """Take out the part of each UAV's motion that closes in on a neighbour of its plane, and stay over the field.

    A neighbour counts when the step would end nearer to it than now and nearer than d_safety, which is what the
    safety risk SR charges (W8); the one that would end up nearest is heeded.

    Args:
        position: UAVs of one plane, [E, n, 2] m.
        action: what they would do, [E, n, 2].
        world: geometry and speeds.

    Returns:
        [E, n, 2] in [-1, 1].
    """
    motion = action * reach(world)
    now = position[:, None] - position[:, :, None]
    then = now + motion[:, None] - motion[:, :, None]
    distance, following = np.hypot(now[..., 0], now[..., 1]), np.hypot(then[..., 0], then[..., 1])
    count = position.shape[1]
    risky = np.logical_and(following < world.safety_distance, following < distance) & ~np.eye(count, dtype=bool)
    nearest = np.expand_dims(np.where(risky, following, np.inf).argmin(axis=2), axis=2)
    heading = np.take_along_axis(now, nearest[..., None], axis=2)[:, :, 0]
    heading = heading / np.maximum(np.take_along_axis(distance, nearest, axis=2), STANDOFF)
    heading = heading * np.expand_dims(risky.any(axis=2), axis=2)
    closing = np.maximum(0.0, (motion * heading).sum(axis=-1, keepdims=True))
    side = position + motion - closing * heading
    inside = np.clip(side, EDGE, np.array([world.field_x, world.field_y]) - EDGE)
    apart: Array = np.clip((inside - position) / reach(world), -1.0, 1.0)
    return apart


def relay_targets(farms: FarmBatch) -> Array:
    """Return for each relay the centre of the UAVs it serves, or its own place when it serves none: [E, n_c, 2] m."""
    relays = farms.team.groups[0].count
    own, served = farms.position[:, :relays], farms.position[:, relays:]
    serves = (farms.assignment[:, None, :] == np.arange(relays)[:, None]).astype(np.float64)
    number = serves.sum(axis=2, keepdims=True)
    centre = np.matmul(serves, served) / np.maximum(number, 1.0)
    target: Array = np.where(number > 0, centre, own)
    return target
