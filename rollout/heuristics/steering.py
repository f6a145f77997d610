"""Steering for all heuristics: fly to a place, loiter there and keep apart.

Actions are velocities as fractions of the top speed along each axis, so a step moves a UAV by
action * (V_x-max, V_y-max) * t_step.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig, WorldConfig
from eia_sec.rollout.sim.boxes import SLOWEST, possible, reach
from eia_sec.rollout.sim.core.constants import constants
from eia_sec.rollout.sim.core.motion import flight_power

Array = NDArray[np.float64]

STANDOFF: Final = 1e-9
"""Least divisor when a direction is normalised, m."""
EDGE: Final = 1e-3
"""Least distance from the field's edge, m. It keeps rounding from putting a UAV outside."""
LOITER_MAX: Final = 1.0
"""Top speed of a waiting UAV, m/s."""
AWAY: Final = 1e9
"""Where steering finds UAVs that are gone, m; far enough to be in nobody's way."""


def towards(position: Array, target: Array, world: WorldConfig, wind: Array | None = None) -> Array:
    """Return the action that flies straight to a target, at full speed until one step suffices.

    Args:
        position: [..., 2] m.
        target: [..., 2] m.
        world: geometry and speeds.
        wind: [..., 2] over top speed; None for none. In wind, a UAV flies slower so that its way stays straight.

    Returns:
        [..., 2] in [-1, 1].
    """
    share = (target - position) / reach(world)
    if wind is not None:
        low, high = possible(wind)
        limit = np.maximum(np.where(share > 0.0, high, -low), SLOWEST)
        straight = share / np.maximum(1.0, (np.abs(share) / limit).max(axis=-1, keepdims=True))
        held: Array = np.clip(straight, low, high)
        return held
    action: Array = share / np.maximum(1.0, np.abs(share).max(axis=-1, keepdims=True))
    return action


def keep_apart(position: Array, action: Array, world: WorldConfig, wind: Array | None = None) -> Array:
    """Remove the part of each UAV's motion that closes in on a neighbour in its plane, and keep UAVs over the field.

    A neighbour counts if the step would end closer to it than now and closer than d_safety, which is what the safety
    risk SR charges (W8). Of several neighbours, the one that would end up nearest counts.

    Args:
        position: UAVs of one plane, [E, n, 2] m.
        action: [E, n, 2] uncorrected actions.
        world: geometry and speeds.
        wind: [E, 1, 2] over top speed; None for none.

    Returns:
        [E, n, 2] in [-1, 1].
    """
    low, high = possible(np.zeros(2) if wind is None else wind)
    apart: Array = np.clip(apart_ways(position, action * reach(world), world) / reach(world), low, high)
    return apart


def apart_ways(position: Array, motion: Array, world: WorldConfig) -> Array:
    """Return ways [E, n, 2] m without what closes in on others, from the ways that UAVs want to make; see above."""
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
    ways: Array = np.clip(side, EDGE, np.array([world.field_x, world.field_y]) - EDGE) - position
    return ways


def loiter_speed(config: FarmConfig) -> float:
    """Return the speed up to LOITER_MAX with the least flight power, m/s. In the printed model hovering costs most."""
    flight = constants(config).flight
    speeds = np.linspace(0.0, LOITER_MAX, 101)
    return float(speeds[np.argmin([flight_power(flight, speed) for speed in speeds])])


def loiter(position: Array, goal: Array, time: NDArray[np.int64], step: float) -> Array:
    """Return the goals, but make a UAV closer than `step` to its goal fly `step` back and forth along x instead.

    Args:
        position: [E, n, 2] m.
        goal: [E, n, 2] m.
        time: [E] steps done; it selects the direction.
        step: distance that a loitering UAV flies in one step, m.

    Returns:
        [E, n, 2] m.
    """
    there = np.abs(goal - position).max(axis=-1) < step
    aside = np.where(time % 2 == 0, step, -step)[:, None, None] * np.array([1.0, 0.0])
    kept: Array = np.where(there[..., None], position + aside, goal)
    return kept
