"""The units that each of nine moves would bring in the next step, and the best of two moves.

A plan holds the 25 lattice points two moves away and then the nine places one move away, or only the latter. An item, a
plot or a sensor, gives each place a share of its counter. What the first move takes is not there for the second.

With inertia a plan holds the places after each step of nine velocities that are held (`inertia`), nine for each step,
and an item counts once on each way.
"""

import math
from typing import Final

from eia_sec.common.farm_observation import HOLD, MOST_UNITS
from eia_sec.rollout.sim.core.camera import plot_quality, span
from eia_sec.rollout.sim.core.compile import allocation_free, inlined
from eia_sec.rollout.sim.core.constants import CameraConstants, FleetConstants, ObservationConstants
from eia_sec.rollout.sim.core.neighbours import block_around, gather
from eia_sec.rollout.sim.core.radio import LEAST_AGE, table_chance
from eia_sec.rollout.sim.core.records import Array, Float32, Indices, Int32
from eia_sec.rollout.sim.observation.arrays import TWO_MOVES, ViewScratch
from eia_sec.rollout.sim.observation.constants import ViewConstants
from eia_sec.rollout.sim.observation.places import go_twice

BELOW: Final = 1.0 - 2.0**-53
"""A positive number times this is the next smaller one."""


@inlined
def begin_plan(
    fleet: FleetConstants, view: ViewConstants, held: bool, two: bool, v: ViewScratch, x: float, y: float, u: int
) -> tuple[float, float, float, float]:
    """Write the places of a UAV's plan and forget the last one's gains.

    Returns:
        the least and largest x and the least and largest y of the places, m.
    """
    place_x, place_y, far_x, far_y = v.place_x, v.place_y, v.far[0], v.far[1]
    place_x[:], place_y[:], v.gain[:], v.twice[:, :] = x, y, 0.0, 0.0
    if held:
        path_x, path_y = v.path_x[u], v.path_y[u]
        for step in range(len(place_x) // 9):
            for move in range(9):
                place_x[9 * step + move], place_y[9 * step + move] = path_x[step, move // 3], path_y[step, move % 3]
        west, east = _stretch(x, path_x)
        south, north = _stretch(y, path_y)
        return west, east, south, north
    if two:
        go_twice(x, v.sign[u, 0], fleet.width, fleet.per_width, view.columns, far_x, v.after[0])
        go_twice(y, v.sign[u, 1], fleet.depth, fleet.per_depth, view.rows, far_y, v.after[1])
        for k in range(TWO_MOVES):
            place_x[k], place_y[k] = far_x[k // 5], far_y[k % 5]
    for move in range(9):
        place_x[view.first + move], place_y[view.first + move] = v.go_x[u, move // 3], v.go_y[u, move % 3]
    west, east = _ends(x, v.go_x[u], far_x, two)
    south, north = _ends(y, v.go_y[u], far_y, two)
    return west, east, south, north


@allocation_free
def _ends(x: float, go: Array, far: Array, two: bool) -> tuple[float, float]:
    """Return the least and the largest place of a plan along an axis, m."""
    low, high = min(x, go[0], go[2]), max(x, go[0], go[2])
    return (min(low, far[0], far[4]), max(high, far[0], far[4])) if two else (low, high)


@allocation_free
def _stretch(x: float, path: Array) -> tuple[float, float]:
    """Return the least and the largest place along an axis of moves that are held, m."""
    low, high = x, x
    for step in range(len(path)):
        for move in range(3):
            low, high = min(low, path[step, move]), max(high, path[step, move])
    return low, high


@allocation_free
def _add_passed(worth: float, chance: Array, gain: Array) -> None:
    """Add an item's units to each move that is held for HOLD steps, and twice as long: the first and the next nine."""
    for move in range(9):
        missed = 1.0
        for step in range(HOLD):
            missed *= 1.0 - chance[9 * step + move]
        gain[move] += worth * (1.0 - missed)
        if len(chance) > 9 * 2 * HOLD - 1:
            for step in range(HOLD, 2 * HOLD):
                missed *= 1.0 - chance[9 * step + move]
            gain[9 + move] += worth * (1.0 - missed)


@allocation_free
def _beyond(bounds: tuple[float, float, float, float], x: float, y: float) -> float:
    """Return the square of the distance from a point to the rectangle of the places, m^2."""
    west, east, south, north = bounds
    dx, dy = max(0.0, west - x, x - east), max(0.0, south - y, y - north)
    return dx * dx + dy * dy


@allocation_free
def _add_item(two: bool, first: int, worth: float, chance: Array, gain: Array, after_x: Indices, twice: Array) -> None:
    """Add an item's units to every place, and what the second move of each pair finds taken.

    The last lattice point of each pair's row in `twice` only fills it up; nothing reads it.
    The numbers of places are read from the arrays, because loops of a fixed length are unrolled and not vectorised.
    """
    for place in range(len(gain)):
        gain[place] += worth * chance[place]
    if two:
        for move in range(9):
            taken = worth * chance[first + move]
            if taken > 0.0:
                start = _first_after(after_x, move)
                for k in range(twice.shape[1]):
                    twice[move, k] += taken * chance[start + k]


@allocation_free
def _first_after(after_x: Indices, move: int) -> int:
    """Return the first of the 25 lattice points that may follow a move; all of them are in three columns of five."""
    first: int = 5 * after_x[3 * (move // 3)]
    return first


@allocation_free
def _own_square(position: Array, first: int, last: int, u: int, x: float, y: float, limit: float) -> float:
    """Return the largest square of a distance from which a point would be a UAV's own, at most `limit`, m^2.

    It is that of the nearest other UAV of the type if u wins a tie, and else the next smaller number.
    """
    rival, owner = math.inf, last
    for other in range(first, last):
        dx, dy = x - position[other, 0], y - position[other, 1]
        square = dx * dx + dy * dy
        if other != u and square < rival:
            rival, owner = square, other
    if u > owner:
        rival = rival * BELOW if rival > 0.0 else -1.0
    return min(rival, limit)


@inlined
def plan_images(
    fleet: FleetConstants,
    camera: CameraConstants,
    view: ViewConstants,
    held: bool,
    two: bool,
    v: ViewScratch,
    position: Array,
    level: Array,
    u: int,
) -> None:
    """Add the VDF of the plots whose image would succeed from each place, the other UAVs being where they are."""
    bounds = begin_plan(fleet, view, held, two, v, position[u, 0], position[u, 1], u)
    left, _ = span(bounds[0], view.image_reach, camera.plot_width, camera.plots_x)
    _, right = span(bounds[1], view.image_reach, camera.plot_width, camera.plots_x)
    low, _ = span(bounds[2], view.image_reach, camera.plot_depth, camera.plots_y)
    _, high = span(bounds[3], view.image_reach, camera.plot_depth, camera.plots_y)
    for column in range(left, right + 1):
        for row in range(low, high + 1):
            if level[column, row] == 0.0:
                continue
            x, y = (column + 0.5) * camera.plot_width, (row + 0.5) * camera.plot_depth
            limit = _own_square(position, fleet.relays, fleet.collectors, u, x, y, view.image_limit)
            if _beyond(bounds, x, y) > limit:
                continue
            _measure(v.place_x, v.place_y, x, y, limit, v.square)
            if _see_plot(camera, view.image_sure, v.place_x, v.place_y, v.square, column, row, v.chance):
                if held:
                    _add_passed(level[column, row], v.chance, v.gain)
                else:
                    _add_item(two, view.first, level[column, row], v.chance, v.gain, v.after[0], v.twice)


@allocation_free
def _measure(place_x: Array, place_y: Array, x: float, y: float, limit: float, square: Array) -> None:
    """Write the squares of the distances to a point, infinite beyond the limit."""
    for place in range(len(square)):
        dx, dy = x - place_x[place], y - place_y[place]
        apart = dx * dx + dy * dy
        square[place] = apart if apart <= limit else math.inf


@allocation_free
def _see_plot(
    camera: CameraConstants,
    sure: float,
    place_x: Array,
    place_y: Array,
    square: Array,
    column: int,
    row: int,
    chance: Array,
) -> bool:
    """Write from which places the image of a plot would succeed; return whether from any."""
    some = False
    for place in range(len(square)):
        good = square[place] <= sure
        if not good and square[place] < math.inf:
            good = plot_quality(camera, place_x[place], place_y[place], column, row) >= camera.threshold
        chance[place] = 1.0 if good else 0.0
        some |= good
    return some


@inlined
def plan_packets(
    fleet: FleetConstants,
    seen: ObservationConstants,
    view: ViewConstants,
    held: bool,
    two: bool,
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
    bounds = begin_plan(fleet, view, held, two, v, x, y, u)
    wide, deep = max(bounds[1] - x, x - bounds[0]), max(bounds[3] - y, y - bounds[2])
    reach = 1.000001 * (math.sqrt(view.chance_limit) + math.sqrt(wide * wide + deep * deep))
    block = block_around(fleet, seen, x, y, reach)
    found = gather(seen, block, x, y, LEAST_AGE, math.inf, reach * reach, sensor, cell_start, age, around, square)
    for entry in range(found):
        j = around[entry]
        own_x, own_y = sensor[0, j], sensor[1, j]
        limit = _own_square(position, fleet.collectors, fleet.uavs, u, own_x, own_y, view.chance_limit)
        if _beyond(bounds, own_x, own_y) <= limit:
            _measure(v.place_x, v.place_y, own_x, own_y, limit, v.square)
            _hear_sensor(view.chance, view.chance_scale, view.chance_limit, v.square, v.chance)
            if held:
                _add_passed(age[j], v.chance, v.gain)
            else:
                _add_item(two, view.first, age[j], v.chance, v.gain, v.after[0], v.twice)


@allocation_free
def _hear_sensor(table: Array, scale: float, limit: float, square: Array, chance: Array) -> None:
    """Write the probability that a sensor's packet arrives at each place.

    Every place is looked up: a branch would be mispredicted.
    """
    for place in range(len(square)):
        heard = table_chance(table, scale, min(square[place], limit))
        chance[place] = heard if square[place] < math.inf else 0.0


@allocation_free
def put_units(held: bool, two: bool, first: int, v: ViewScratch, per_unit: float, out: Float32, at: int) -> int:
    """Write the units of each move over their scale, then the best of each move and another; return where they end.

    Of moves that are held, the latter are those of twice as many steps.
    """
    gain, twice, after_x, after_y = v.gain, v.twice, v.after[0], v.after[1]
    for move in range(9):
        out[at + move] = min(MOST_UNITS, gain[first + move] * per_unit)
    at += 9
    if two and held:
        for move in range(9):
            out[at + move] = min(2.0 * MOST_UNITS, gain[9 + move] * per_unit)
        at += 9
    elif two:
        for move in range(9):
            best, start = 0.0, _first_after(after_x, move)
            for then in range(9):
                k = 5 * after_x[3 * (move // 3) + then // 3] + after_y[3 * (move % 3) + then % 3]
                best = max(best, gain[k] - twice[move, k - start])
            out[at + move] = min(2.0 * MOST_UNITS, (gain[first + move] + best) * per_unit)
        at += 9
    return at
