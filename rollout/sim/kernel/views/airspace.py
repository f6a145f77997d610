"""The wind that a UAV feels, and the moves that no-fly zones refuse."""

import numpy as np
from numpy.typing import NDArray

from eia_sec.rollout.sim.kernel.arrays import Farm, Scratch
from eia_sec.rollout.sim.kernel.compiler.decorators import inlined
from eia_sec.rollout.sim.kernel.constants import Constants
from eia_sec.rollout.sim.kernel.flight.airspace import refused

Float32 = NDArray[np.float32]
Flags = NDArray[np.bool_]


@inlined
def find_stopped(c: Constants, farm: Farm, s: Scratch, u: int) -> None:
    """Find which of nine moves of a UAV a zone would refuse, where something is to see of it; without zones none is."""
    v, x, y = s.added, farm.position[u, 0], farm.position[u, 1]
    if c.airspace.zones and (c.added.zones or c.ways.some):
        for move in range(9):
            to_x, to_y = v.go_x[u, move // 3], v.go_y[u, move % 3]
            v.stopped[move] = refused(c.airspace.first, farm.zone_side, farm.zone_box, x, y, to_x, to_y)


@inlined
def put_airspace(c: Constants, farm: Farm, stopped: Flags, sx: float, sy: float, seen: Float32, at: int) -> int:
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
        for move in range(9):
            seen[at + move] = 1.0 if stopped[move] else 0.0
        at += 9
    return at
