"""The UAV nearest to a place, and the sensors nearest to a UAV, found through the sensor cells."""

import math
from typing import Final

from eia_sec.rollout.sim.core.cells import cell_of
from eia_sec.rollout.sim.core.compile import allocation_free
from eia_sec.rollout.sim.core.constants import FleetConstants, ObservationConstants
from eia_sec.rollout.sim.core.records import Array, Indices, Int32

ALL: Final = 0
"""Any sensor counts."""
HOLDING: Final = 1
"""Only sensors that hold data count."""
EMPTY: Final = 2
"""Only sensors that hold no data count."""
WAITING: Final = 0.5
"""Least AoI of a sensor that holds data; AoI is a whole number."""


@allocation_free
def is_nearest(
    position: Array, apart_square: Array, first: int, last: int, u: int, x: float, y: float, square: float
) -> bool:
    """Return whether a UAV is the closest of its plane to a place; ties go to the lowest index.

    A place less than half as far away as the next UAV of the plane needs no comparison.

    Args:
        position: [n, 2] m.
        apart_square: [n] square of the distance to the nearest UAV of the plane, m^2.
        first: first UAV of the plane.
        last: one past the last.
        u: the UAV.
        x: x of the place, m.
        y: y of the place, m.
        square: square of the distance between UAV and place, m^2.
    """
    if 4.000001 * square < apart_square[u]:
        return True
    for other in range(first, last):
        if other != u:
            dx, dy = x - position[other, 0], y - position[other, 1]
            rival = dx * dx + dy * dy
            if rival < square or (rival == square and other < u):
                return False
    return True


@allocation_free
def gather(
    seen: ObservationConstants,
    block: tuple[int, int, int, int],
    x: float,
    y: float,
    least: float,
    below: float,
    limit: float,
    sensor: Array,
    cell_start: Int32,
    age: Array,
    around: Indices,
    square: Array,
) -> int:
    """List the near sensors of a block of cells with AoI in a range, in ascending order.

    The cells of one column are consecutive, so each column is one run. The loop has no branch per sensor, because the
    processor could not predict it.

    Args:
        seen: the sensor cells.
        block: first and last column, first and last row.
        x: x of the place, m.
        y: y of the place, m.
        least: least AoI.
        below: AoI must be below this.
        limit: largest square of the distance, m^2.
        sensor: [2, S] m.
        cell_start: first sensor of each cell.
        age: [S] AoI.
        around: [S + 1] out: the sensors.
        square: [S + 1] out: squares of their distances, m^2.

    Returns:
        the number of sensors listed.
    """
    west, east, south, north = block
    found = 0
    for column in range(west, east + 1):
        for j in range(cell_start[column * seen.cells_y + south], cell_start[column * seen.cells_y + north + 1]):
            dx, dy = sensor[0, j] - x, sensor[1, j] - y
            apart = dx * dx + dy * dy
            around[found], square[found] = j, apart
            found += (age[j] >= least) & (age[j] < below) & (apart <= limit)
    return found


@allocation_free
def block_around(
    fleet: FleetConstants, seen: ObservationConstants, x: float, y: float, reach: float
) -> tuple[int, int, int, int]:
    """Return first and last column, first and last row of the cells within `reach` of a place."""
    return (
        cell_of((x - reach) / fleet.width, seen.cells_x),
        cell_of((x + reach) / fleet.width, seen.cells_x),
        cell_of((y - reach) / fleet.depth, seen.cells_y),
        cell_of((y + reach) / fleet.depth, seen.cells_y),
    )


@allocation_free
def nearest_sensors(
    fleet: FleetConstants,
    seen: ObservationConstants,
    x: float,
    y: float,
    sort: int,
    sensor: Array,
    cell_start: Int32,
    age: Array,
    total: int,
    around: Indices,
    square: Array,
    nearest: Indices,
    nearest_square: Array,
) -> int:
    """List the sensors of a sort nearest to a place, nearest first; ties go to the lowest index.

    The list from before the call bounds the search: if enough of its sensors are of the sort, the search goes no
    farther than the farthest of them. The previous step's list usually qualifies.

    Args:
        fleet: the field.
        seen: the sensor cells.
        x: x of the place, m.
        y: y of the place, m.
        sort: ALL, HOLDING or EMPTY.
        sensor: [2, S] m.
        cell_start: first sensor of each cell.
        age: [S] AoI.
        total: number of sensors of the sort.
        around: [S + 1] scratch.
        square: [S + 1] scratch.
        nearest: [wanted] in: distinct sensors; out: the nearest.
        nearest_square: [wanted] out: squares of their distances, m^2.

    Returns:
        the number of sensors listed; fewer than wanted only if there are no more.
    """
    wanted = min(len(nearest), total)
    if wanted == 0:
        return 0
    least, below = WAITING if sort == HOLDING else -1.0, WAITING if sort == EMPTY else math.inf
    limit, known = 0.0, 0
    for j in nearest:
        dx, dy = sensor[0, j] - x, sensor[1, j] - y
        counts = (age[j] >= least) & (age[j] < below)
        known += counts
        limit = max(limit, dx * dx + dy * dy if counts else 0.0)
    if known < wanted:
        limit = 1.5 * max(limit, seen.start_square)
    while True:
        block = block_around(fleet, seen, x, y, 1.000001 * math.sqrt(limit))
        found = gather(seen, block, x, y, least, below, limit, sensor, cell_start, age, around, square)
        if found >= wanted:
            return _select(around, square, found, wanted, nearest, nearest_square)
        limit *= 2.0


@allocation_free
def _select(around: Indices, square: Array, found: int, wanted: int, nearest: Indices, nearest_square: Array) -> int:
    """Write the entries with the least squares in ascending order; return their number. The input ascends by index."""
    held = 0
    for entry in range(found):
        apart = square[entry]
        if held == wanted and apart >= nearest_square[held - 1]:
            continue
        place = held if held < wanted else wanted - 1
        held = min(held + 1, wanted)
        while place > 0 and apart < nearest_square[place - 1]:
            nearest_square[place], nearest[place] = nearest_square[place - 1], nearest[place - 1]
            place -= 1
        nearest_square[place], nearest[place] = apart, around[entry]
    return held
