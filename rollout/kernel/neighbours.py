"""Which sensors lie around each data collection UAV, by way of the cells in which sensors are numbered."""

from typing import Final

from rollout.kernel.compiled import compiled
from rollout.kernel.constants import Array, FleetConstants, Indices, ObservationConstants

WAITING: Final = 0.5
"""AoI from which on a sensor counts as holding data; without expected delivery AoI is a whole number."""


@compiled
def gather(
    fleet: FleetConstants,
    seen: ObservationConstants,
    position: Array,
    sensor: Array,
    cell_start: Indices,
    around: Indices,
    square: Array,
    number: Indices,
) -> None:
    """List the sensors around each data collection UAV: all within radio reach, and at least the n nearest.

    Args:
        fleet: the UAVs.
        seen: where the search starts and how many must be found.
        position: [n, 2] m.
        sensor: [2, S] m.
        cell_start: first sensor of each cell.
        around: [n_d, S] out: the sensors, in no particular order.
        square: [n_d, S] out: squares of their horizontal distances, m^2.
        number: [n_d] out: how many.
    """
    for k in range(len(number)):
        x, y = position[fleet.collectors + k]
        radius = seen.radius
        while True:
            number[k] = _within(fleet, seen, x, y, radius, sensor, cell_start, around[k], square[k])
            if number[k] >= seen.sensors or radius >= fleet.diagonal:
                break
            radius *= 2.0


@compiled
def prefer_waiting(
    fleet: FleetConstants,
    seen: ObservationConstants,
    position: Array,
    sensor: Array,
    cell_start: Indices,
    age: Array,
    around: Indices,
    square: Array,
    number: Indices,
) -> None:
    """List the sensors around each UAV anew, those that hold no data behind all others.

    Args:
        fleet: the UAVs.
        seen: where the search starts and how many that hold data must be found, if there are so many.
        position: [n, 2] m.
        sensor: [2, S] m.
        cell_start: first sensor of each cell.
        age: [S] AoI.
        around: [n_d, S] out: the sensors, in no particular order.
        square: [n_d, S] out: what to sort by: squares of their distances, m^2, with more than the field's diagonal
            on top where there is no data.
        number: [n_d] out: how many.
    """
    behind = 2.0 * fleet.diagonal * fleet.diagonal
    for k in range(len(number)):
        x, y = position[fleet.collectors + k]
        radius = seen.radius
        while True:
            number[k] = _within(fleet, seen, x, y, radius, sensor, cell_start, around[k], square[k])
            waiting = 0
            for entry in range(number[k]):
                if age[around[k, entry]] >= WAITING:
                    waiting += 1
                else:
                    square[k, entry] += behind
            if waiting >= seen.sensors or radius >= fleet.diagonal:
                break
            radius *= 2.0


@compiled
def _within(
    fleet: FleetConstants,
    seen: ObservationConstants,
    x: float,
    y: float,
    radius: float,
    sensor: Array,
    cell_start: Indices,
    around: Indices,
    square: Array,
) -> int:
    """List the sensors within a radius; the cells of one column are consecutive, so a column is one run."""
    left = cell_of((x - radius) / fleet.width, seen.cells_x)
    right = cell_of((x + radius) / fleet.width, seen.cells_x)
    low = cell_of((y - radius) / fleet.depth, seen.cells_y)
    high = cell_of((y + radius) / fleet.depth, seen.cells_y)
    found, limit = 0, radius * radius
    for column in range(left, right + 1):
        for j in range(cell_start[column * seen.cells_y + low], cell_start[column * seen.cells_y + high + 1]):
            dx, dy = sensor[0, j] - x, sensor[1, j] - y
            apart = dx * dx + dy * dy
            if apart <= limit:
                around[found], square[found] = j, apart
                found += 1
    return found


@compiled
def cell_of(share: float, cells: int) -> int:
    """Return the cell at a share of the axis, by the very product with which the layout numbers sensors."""
    return int(min(cells - 1.0, max(0.0, share * cells)))


@compiled
def is_nearest(position: Array, first: int, last: int, u: int, x: float, y: float, apart: float) -> bool:
    """Return whether UAV u, `apart` (squared, m^2) from a place, is the closest; ties go to the lowest index."""
    for other in range(first, last):
        if other != u:
            dx, dy = x - position[other, 0], y - position[other, 1]
            square = dx * dx + dy * dy
            if square < apart or (square == apart and other < u):
                return False
    return True
