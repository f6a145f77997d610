"""The units that each of nine moves would bring in the next step, and the best of two moves.

A plan has nine places one move away and 25 lattice points two moves away. An item, a plot or a sensor, gives each place
a share of its counter. What the first move takes is not there for the second.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rollout.sim.kernel.camera import plot_quality, span
from rollout.sim.kernel.compiler.decorators import allocation_free
from rollout.sim.kernel.constants import (
    Array,
    CameraConstants,
    FleetConstants,
    Indices,
    Int32,
    ObservationConstants,
)
from rollout.sim.kernel.radio import LEAST_AGE
from rollout.sim.kernel.spatial.neighbours import block_around, gather
from rollout.sim.kernel.views.arrays import FAR, PLACES, ViewScratch
from rollout.sim.kernel.views.constants import PIECES, ViewConstants
from rollout.sim.kernel.views.places import go_twice

Float32 = NDArray[np.float32]

MOST: Final = 2.0
"""Most units of one move that are seen, over their scale; two moves may bring twice as many (ours)."""


@allocation_free
def begin_plan(
    fleet: FleetConstants, view: ViewConstants, v: ViewScratch, x: float, y: float, u: int
) -> tuple[float, float, float, float]:
    """Write the places of a UAV's plan and forget the last one's gains.

    Returns:
        the least and largest x and the least and largest y of the places, m.
    """
    place_x, place_y, far_x, far_y = v.place_x, v.place_y, v.far[0], v.far[1]
    place_x[:], place_y[:] = x, y
    v.gain[:], v.chance[:] = 0.0, 0.0
    for move in range(9):
        place_x[move], place_y[move] = v.go_x[u, move // 3], v.go_y[u, move % 3]
    if view.units > 1:
        v.twice[:, :] = 0.0
        go_twice(x, v.sign[u, 0], fleet.width, fleet.per_width, view.columns, far_x, v.after[0])
        go_twice(y, v.sign[u, 1], fleet.depth, fleet.per_depth, view.rows, far_y, v.after[1])
        for k in range(25):
            place_x[FAR + k], place_y[FAR + k] = far_x[k // 5], far_y[k % 5]
    west, east, south, north = x, x, y, y
    for place in range(PLACES):
        west, east = min(west, place_x[place]), max(east, place_x[place])
        south, north = min(south, place_y[place]), max(north, place_y[place])
    return west, east, south, north


@allocation_free
def _add_item(view: ViewConstants, v: ViewScratch, worth: float) -> None:
    """Add an item's units to every place, and what the second move of each pair finds taken."""
    chance, gain = v.chance, v.gain
    for place in range(PLACES):
        gain[place] += worth * chance[place]
    if view.units > 1:
        for move in range(9):
            taken, row = worth * chance[move], v.twice[move]
            if taken > 0.0:
                for k in range(PLACES - FAR):
                    row[k] += taken * chance[FAR + k]


@allocation_free
def _rival(position: Array, first: int, last: int, u: int, x: float, y: float) -> tuple[float, bool]:
    """Return the square of the distance from a place to the nearest other UAV of a type, m^2, and who wins a tie."""
    least, owner = math.inf, last
    for other in range(first, last):
        dx, dy = x - position[other, 0], y - position[other, 1]
        square = dx * dx + dy * dy
        if other != u and square < least:
            least, owner = square, other
    return least, u < owner


@allocation_free
def plan_images(
    fleet: FleetConstants,
    camera: CameraConstants,
    view: ViewConstants,
    v: ViewScratch,
    position: Array,
    level: Array,
    u: int,
) -> None:
    """Add the VDF of the plots whose image would succeed from each place, the other UAVs being where they are."""
    west, east, south, north = begin_plan(fleet, view, v, position[u, 0], position[u, 1], u)
    left, _ = span(west, camera.reach, camera.plot_width, camera.plots_x)
    _, right = span(east, camera.reach, camera.plot_width, camera.plots_x)
    low, _ = span(south, camera.reach, camera.plot_depth, camera.plots_y)
    _, high = span(north, camera.reach, camera.plot_depth, camera.plots_y)
    for column in range(left, right + 1):
        for row in range(low, high + 1):
            if level[column, row] > 0.0 and _see_plot(fleet, camera, v, position, u, column, row):
                _add_item(view, v, level[column, row])


@allocation_free
def _see_plot(
    fleet: FleetConstants, camera: CameraConstants, v: ViewScratch, position: Array, u: int, column: int, row: int
) -> bool:
    """Write from which places the image of a plot would succeed; return whether from any."""
    x, y = (column + 0.5) * camera.plot_width, (row + 0.5) * camera.plot_depth
    rival, wins = _rival(position, fleet.relays, fleet.collectors, u, x, y)
    place_x, place_y, chance, near = v.place_x, v.place_y, v.chance, 0.0
    for place in range(PLACES):
        dx, dy = x - place_x[place], y - place_y[place]
        square = dx * dx + dy * dy
        hit = (square <= camera.centre_square) & ((square < rival) | ((square == rival) & wins))
        chance[place] = 1.0 if hit else 0.0
    for place in range(PLACES):
        if chance[place] > 0.0:
            good = plot_quality(camera, place_x[place], place_y[place], column, row) >= camera.threshold
            chance[place] = 1.0 if good else 0.0
            near += chance[place]
    return near > 0.0


@allocation_free
def plan_packets(
    fleet: FleetConstants,
    seen: ObservationConstants,
    view: ViewConstants,
    v: ViewScratch,
    position: Array,
    sensor: Array,
    cell_start: Int32,
    age: Array,
    around: Indices,
    square: Array,
    u: int,
) -> None:
    """Add the AoI that is expected to arrive at each place, the other UAVs being where they are."""
    x, y = position[u, 0], position[u, 1]
    west, east, south, north = begin_plan(fleet, view, v, x, y, u)
    wide, deep = max(east - x, x - west), max(north - y, y - south)
    reach = 1.000001 * (math.sqrt(view.chance_limit) + math.sqrt(wide * wide + deep * deep))
    block = block_around(fleet, seen, x, y, reach)
    found = gather(seen, block, x, y, LEAST_AGE, math.inf, reach * reach, sensor, cell_start, age, around, square)
    for entry in range(found):
        j = around[entry]
        rival, wins = _rival(position, fleet.collectors, fleet.uavs, u, sensor[0, j], sensor[1, j])
        _hear_sensor(view, v, sensor[0, j], sensor[1, j], rival, wins)
        _add_item(view, v, age[j])


@allocation_free
def _hear_sensor(view: ViewConstants, v: ViewScratch, x: float, y: float, rival: float, wins: bool) -> None:
    """Write the probability that a sensor's packet arrives at each place, several at once."""
    place_x, place_y, chance, table = v.place_x, v.place_y, v.chance, view.chance
    for place in range(PLACES):
        dx, dy = x - place_x[place], y - place_y[place]
        square = dx * dx + dy * dy
        at = min(square * view.chance_scale, np.float64(PIECES))
        piece = np.uint64(at)
        share = table[piece] + (at - np.float64(piece)) * (table[piece + np.uint64(1)] - table[piece])
        hit = (square <= view.chance_limit) & ((square < rival) | ((square == rival) & wins))
        chance[place] = share if hit else 0.0


@allocation_free
def put_units(view: ViewConstants, v: ViewScratch, per_unit: float, out: Float32, at: int) -> int:
    """Write the units of each move over their scale, then the best of each move and another; return where they end."""
    gain, twice, after_x, after_y = v.gain, v.twice, v.after[0], v.after[1]
    for move in range(9):
        out[at + move] = min(MOST, gain[move] * per_unit)
    at += 9
    if view.units > 1:
        for move in range(9):
            best = 0.0
            for then in range(9):
                k = 5 * after_x[3 * (move // 3) + then // 3] + after_y[3 * (move % 3) + then % 3]
                best = max(best, gain[FAR + k] - twice[move, k])
            out[at + move] = min(2.0 * MOST, (gain[move] + best) * per_unit)
        at += 9
    return at
