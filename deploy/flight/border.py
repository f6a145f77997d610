"""The field's border: how fast a vehicle may fly towards it, so that it stops before."""

import math

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig


def inside_border(
    config: FarmConfig, row: int, velocity: NDArray[np.float64], place: tuple[float, float]
) -> tuple[float, float]:
    """Return a velocity that leads towards no border faster than the vehicle can stop, m/s.

    The simulator stops a UAV at the border at once. With inertia a vehicle needs v^2 / (2 a) + v a / (2 j) to stop,
    besides what it flies in a step; without, it stands where the step ends. A vehicle outside may only come back.

    Args:
        config: the farm.
        row: the agent's number in the team.
        velocity: [2] the decision, m/s.
        place: where the vehicle is, m.
    """
    world, seconds = config.world, config.world.step_seconds
    kind = int(np.searchsorted(np.cumsum(config.world.counts), row, side="right"))
    most, jerk = (config.dynamics.of_types(name)[kind] for name in ("acceleration", "jerk"))
    brake = most * (seconds + most / (2.0 * jerk))
    found = []
    for speed, at, side in zip(velocity.tolist(), place, (world.field_x, world.field_y), strict=True):
        ahead = max(0.0, side - at if speed > 0.0 else at)
        limit = ahead / seconds
        if config.dynamics.inertial:
            limit = math.sqrt(brake * brake + 2.0 * most * ahead) - brake
        found.append(min(speed, limit) if speed > 0.0 else max(speed, -limit))
    return found[0], found[1]
