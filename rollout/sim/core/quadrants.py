"""D_VDF and D_AoI: the quadrant around a UAV with the largest sum (W25).

Quadrants are numbered (+,+), (-,+), (-,-), (+,-). A sensor or plot level with the UAV belongs to the positive side.
Ties go to the first quadrant. If every sum is 0, there is no direction.
"""

import math
from typing import Final

from eia_sec.rollout.sim.core.arrays import Farm
from eia_sec.rollout.sim.core.cells import cell_of
from eia_sec.rollout.sim.core.compile import allocation_free, inlined
from eia_sec.rollout.sim.core.constants import Constants, ObservationConstants
from eia_sec.rollout.sim.core.records import Array, Int32

DIAGONAL: Final = math.sqrt(0.5)


CLEAR: Final = 1e-6
"""If a sum leads by this much AoI, its sensors need no closer look; rounding cannot cause such a lead."""


@allocation_free
def diagonal(sums: tuple[float, float, float, float]) -> tuple[float, float]:
    """Return the unit diagonal towards the largest sum, (0, 0) if all four are 0."""
    best, most = 0, sums[0]
    for quadrant in range(1, 4):
        if sums[quadrant] > most:
            best, most = quadrant, sums[quadrant]
    length = DIAGONAL if most > 0.0 else 0.0
    return length if best in (0, 3) else -length, length if best in (0, 1) else -length


@inlined
def point_to_age(c: Constants, farm: Farm) -> None:
    """Write D_AoI of every data collection UAV into `direction`.

    The tally of AoI sums whole cells first. A UAV's quadrants divide only the cells of its own column and row. Their
    sensors are examined only if they could change which sum is largest.
    """
    fleet, seen, position, sensor, cell_start, by_row, row_start, age = (
        c.fleet,
        c.observation,
        farm.position,
        farm.sensor,
        farm.cell_start,
        farm.by_row,
        farm.row_start,
        farm.age,
    )
    below, above, direction = farm.age_below, farm.age_above, farm.direction
    for u in range(fleet.collectors, fleet.uavs):
        if farm.gone[u]:
            continue
        x, y = position[u, 0], position[u, 1]
        i, k = cell_of(x / fleet.width, seen.cells_x), cell_of(y / fleet.depth, seen.cells_y)
        northeast, northwest, southwest, southeast = 0.0, 0.0, 0.0, 0.0
        west, east = 0.0, 0.0
        for column in range(i):
            northwest += above[k + 1, column]
            southwest += below[k, column]
            west += above[k, column]
        for column in range(i + 1, seen.cells_x):
            northeast += above[k + 1, column]
            southeast += below[k, column]
            east += above[k, column]
        west, east, north, south = west - northwest, east - northeast, above[k + 1, i], below[k, i]
        own = above[k, i] - north + CLEAR
        sums = northeast, northwest, southwest, southeast
        if not _decided(sums, (north + east + own, north + west + own, south + west + own, south + east + own)):
            sums = _divide(seen, x, y, i, k, sensor, cell_start, by_row, row_start, age, sums)
        direction[u, 0], direction[u, 1] = diagonal(sums)


@allocation_free
def _decided(sums: tuple[float, float, float, float], more: tuple[float, float, float, float]) -> bool:
    """Return whether one sum stays the largest, however much of `more` is added to each."""
    best = 0
    for quadrant in range(1, 4):
        if sums[quadrant] > sums[best]:
            best = quadrant
    rival = -1.0
    for quadrant in range(4):
        rival = max(rival, sums[quadrant] + more[quadrant] if quadrant != best else -1.0)
    return rival < sums[best]


@allocation_free
def _divide(
    seen: ObservationConstants,
    x: float,
    y: float,
    i: int,
    k: int,
    sensor: Array,
    cell_start: Int32,
    by_row: Int32,
    row_start: Int32,
    age: Array,
    sums: tuple[float, float, float, float],
) -> tuple[float, float, float, float]:
    """Return the quadrants' sums around (x, y), with the sensors in cell column i and cell row k added."""
    rows, (northeast, northwest, southwest, southeast) = seen.cells_y, sums
    first, last = cell_start[i * rows + k], cell_start[i * rows + k + 1]
    for j in range(cell_start[i * rows], first):
        amount, east = age[j], sensor[0, j] >= x
        southeast += amount if east else 0.0
        southwest += 0.0 if east else amount
    for j in range(first, last):
        amount, east, north = age[j], sensor[0, j] >= x, sensor[1, j] >= y
        northeast += amount if east and north else 0.0
        northwest += amount if north and not east else 0.0
        southwest += 0.0 if east or north else amount
        southeast += amount if east and not north else 0.0
    for j in range(last, cell_start[(i + 1) * rows]):
        amount, east = age[j], sensor[0, j] >= x
        northeast += amount if east else 0.0
        northwest += 0.0 if east else amount
    place = k * seen.cells_x + i
    for p in range(row_start[k * seen.cells_x], row_start[place]):
        amount, north = age[by_row[p]], sensor[1, by_row[p]] >= y
        northwest += amount if north else 0.0
        southwest += 0.0 if north else amount
    for p in range(row_start[place + 1], row_start[(k + 1) * seen.cells_x]):
        amount, north = age[by_row[p]], sensor[1, by_row[p]] >= y
        northeast += amount if north else 0.0
        southeast += 0.0 if north else amount
    return northeast, northwest, southwest, southeast


@inlined
def point_to_level(c: Constants, farm: Farm) -> None:
    """Write D_VDF of every monitoring UAV into `direction`, from the VDF at the plot centres in each quadrant."""
    fleet, camera, position, direction = c.fleet, c.camera, farm.position, farm.direction
    below, above = farm.level_below, farm.level_above
    for u in range(fleet.relays, fleet.collectors):
        if farm.gone[u]:
            continue
        i = _first_centre(position[u, 0], camera.plot_width, camera.plots_x)
        j = _first_centre(position[u, 1], camera.plot_depth, camera.plots_y)
        northeast, northwest, southwest, southeast = 0.0, 0.0, 0.0, 0.0
        for column in range(i):
            northwest += above[j, column]
            southwest += below[j, column]
        for column in range(i, camera.plots_x):
            northeast += above[j, column]
            southeast += below[j, column]
        direction[u, 0], direction[u, 1] = diagonal((northeast, northwest, southwest, southeast))


@allocation_free
def _first_centre(place: float, size: float, plots: int) -> int:
    """Return the first plot along an axis whose centre is at or beyond a place."""
    first = int(min(float(plots), max(0.0, math.floor(place / size - 0.5))))
    while first < plots and (first + 0.5) * size < place:
        first += 1
    return first
