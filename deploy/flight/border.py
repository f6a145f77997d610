"""The field's border: how fast a vehicle may fly towards it, so that it stops before."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig

MARGIN: Final = 1.0
"""Distance from the border that is kept, m: late poses make a vehicle that brakes overshoot by some decimetres."""


def inside_border(
    config: FarmConfig, row: int, velocity: NDArray[np.float64], place: tuple[float, float], blind: float
) -> tuple[float, float]:
    """Return a velocity that leads towards no border faster than the vehicle can stop, m/s.

    The simulator stops a UAV at the border at once. A vehicle needs v^2 / (2 a) + v a / (2 j) to stop, besides what it
    flies before it hears of it; a and j are those of `farm.dynamics`, also where the simulator does without. A vehicle
    outside may only come back.

    Args:
        config: the farm.
        row: the agent's number in the team.
        velocity: [2] the decision, m/s.
        place: where the vehicle was, m.
        blind: longest time from then to the end of the set-point, s.
    """
    world = config.world
    kind = int(np.searchsorted(np.cumsum(config.world.counts), row, side="right"))
    most, jerk = (config.dynamics.of_types(name)[kind] for name in ("acceleration", "jerk"))
    brake = most * (blind + most / (2.0 * jerk))
    found = []
    for speed, at, side in zip(velocity.tolist(), place, (world.field_x, world.field_y), strict=True):
        ahead = max(0.0, (side - at if speed > 0.0 else at) - MARGIN)
        limit = math.sqrt(brake * brake + 2.0 * most * ahead) - brake
        found.append(min(speed, limit) if speed > 0.0 else max(speed, -limit))
    return found[0], found[1]
