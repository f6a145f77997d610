"""Running sums of VDF over plots and of AoI over sensor cells, from which quadrants are summed without a scan.

A tally is two tables [rows + 1, columns]. For column i, `below[r, i]` sums the rows below r, and `above[r, i]` sums row
r and the rows above it. A quadrant's sum is then the sum of part of one table row. Counters are whole numbers,
so adding to a tally gives the same bits as a recount.
"""

from eia_sec.rollout.sim.core.cells import cell_of
from eia_sec.rollout.sim.core.compile import allocation_free
from eia_sec.rollout.sim.core.constants import FleetConstants, ObservationConstants
from eia_sec.rollout.sim.core.neighbours import WAITING
from eia_sec.rollout.sim.core.records import Array, Indices, Int32


@allocation_free
def add(below: Array, above: Array, column: int, row: int, amount: float) -> None:
    """Add an amount at one grid cell."""
    for r in range(row + 1, len(below)):
        below[r, column] += amount
    for r in range(row + 1):
        above[r, column] += amount


@allocation_free
def _accumulate(below: Array, above: Array) -> None:
    """Turn the amounts of all cells, given in `above`, into the tally."""
    rows, columns = len(above) - 1, above.shape[1]
    for column in range(columns):
        below[0, column], above[rows, column] = 0.0, 0.0
    for r in range(rows):
        for column in range(columns):
            below[r + 1, column] = below[r, column] + above[r, column]
    for r in range(rows - 1, -1, -1):
        for column in range(columns):
            above[r, column] += above[r + 1, column]


@allocation_free
def tally_plots(level: Array, below: Array, above: Array) -> None:
    """Recount VDF [n_px, n_py]."""
    for column in range(level.shape[0]):
        for row in range(level.shape[1]):
            above[row, column] = level[column, row]
    _accumulate(below, above)


@allocation_free
def tally_sensors(
    seen: ObservationConstants, cell_start: Int32, age: Array, below: Array, above: Array, waiting: Indices
) -> None:
    """Recount AoI [S], and write the number of sensors that hold data to `waiting` [1]."""
    waiting[0] = 0
    for column in range(seen.cells_x):
        for row in range(seen.cells_y):
            cell, amount = column * seen.cells_y + row, 0.0
            for j in range(cell_start[cell], cell_start[cell + 1]):
                amount += age[j]
                waiting[0] += 1 if age[j] >= WAITING else 0
            above[row, column] = amount
    _accumulate(below, above)


@allocation_free
def add_sensor(
    fleet: FleetConstants,
    seen: ObservationConstants,
    x: float,
    y: float,
    amount: float,
    holders: int,
    below: Array,
    above: Array,
    waiting: Indices,
) -> None:
    """Add an amount to the AoI at (x, y), and `holders` to the number of sensors that hold data."""
    column, row = cell_of(x / fleet.width, seen.cells_x), cell_of(y / fleet.depth, seen.cells_y)
    add(below, above, column, row, amount)
    waiting[0] += holders


@allocation_free
def total(above: Array) -> float:
    """Return the sum over the whole grid."""
    amount = 0.0
    for column in range(above.shape[1]):
        amount += above[0, column]
    return amount
