"""The wind that a UAV feels, and the moves that no-fly zones refuse."""

import numpy as np
from numpy.typing import NDArray

from rollout.sim.kernel.arrays import Farm
from rollout.sim.kernel.compiler.decorators import inlined
from rollout.sim.kernel.constants import Array, Constants
from rollout.sim.kernel.flight.airspace import refused

Float32 = NDArray[np.float32]


@inlined
def put_airspace(
    c: Constants, farm: Farm, u: int, sx: float, sy: float, go_x: Array, go_y: Array, seen: Float32, at: int
) -> int:
    """Write the wind of the last step over full speed, and 1 for each of nine moves that a zone would refuse.

    Returns:
        where they end.
    """
    if c.added.wind:
        seen[at], seen[at + 1] = 0.0, 0.0
        if c.airspace.wind:
            seen[at] = sx * farm.wind[farm.step, 0] / c.fleet.speed_x
            seen[at + 1] = sy * farm.wind[farm.step, 1] / c.fleet.speed_y
        at += 2
    if c.added.zones:
        x, y = farm.position[u, 0], farm.position[u, 1]
        for move in range(9):
            to_x, to_y = go_x[move // 3], go_y[move % 3]
            stop = refused(c.airspace.first, farm.zone_side, farm.zone_box, x, y, to_x, to_y)
            seen[at + move] = 1.0 if stop else 0.0
        at += 9
    return at
