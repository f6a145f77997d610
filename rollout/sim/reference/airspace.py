"""Wind and no-fly zones of the reference farm: what they do to flight, and what UAVs see of them."""

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config.farm.polygons import refused
from eia_sec.rollout.sim.reference.state import FarmState

Array = NDArray[np.float64]


def air_velocity(farm: FarmState, ground: Array) -> tuple[Array, Array]:
    """Return the velocities through the air and over ground, [n, 2] m/s each, that commanded ones [n, 2] lead to."""
    world = farm.config.world
    if not farm.config.wind.some:
        return ground, ground
    top, wind = np.array([world.speed_x_max, world.speed_y_max]), farm.wind[farm.time]
    possible = np.clip(ground, wind - top, wind + top)
    return possible - wind, possible


def stopped(farm: FarmState, goal: Array) -> NDArray[np.bool_]:
    """Return which UAVs a zone stops on their way to the places [n, 2] m."""
    return refused(farm.position, goal, farm.layout.zones)


def airspace_view(farm: FarmState, u: int, signs: Array, goals: Array) -> Array:
    """Return the wind that a UAV feels over full speed, and which moves to the places [9, 2] m zones refuse."""
    seen, world, parts = farm.config.observation, farm.config.world, [np.zeros(0)]
    if seen.wind:
        wind = farm.wind[farm.time] if farm.config.wind.some else np.zeros(2)
        parts.append(signs * wind / (world.speed_x_max, world.speed_y_max))
    if seen.zones:
        parts.append(refused(farm.position[u], goals, farm.layout.zones).astype(np.float64))
    return np.concatenate(parts)
