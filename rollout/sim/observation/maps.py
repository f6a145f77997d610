"""Coarse maps around a UAV along its own axes: blocks of 4 x 4 plots, sensor cells, and blocks of 4 x 4 cells."""

from eia_sec.common.farm_observation import BLOCK, BLOCKS, CELLS
from eia_sec.rollout.sim.core.compile import allocation_free
from eia_sec.rollout.sim.core.records import Array, Float32


@allocation_free
def block_ends(own: int, sign: float, block: int, count: int) -> tuple[int, int]:
    """Return the first plot of a block along an axis and one past its last, those in the field."""
    low = own + (BLOCK * block - 2 if sign > 0.0 else -BLOCK * block - 1)
    return max(0, low), min(count, low + BLOCK)


@allocation_free
def _sum(above: Array, west: int, east: int, south: int, north: int) -> float:
    """Return the sum over columns west to east - 1 and rows south to north - 1 of a tally."""
    amount = 0.0
    if south < north:
        for column in range(west, east):
            amount += above[south, column] - above[north, column]
    return max(0.0, amount)


@allocation_free
def put_plots(
    level: Array,
    above: Array,
    column: int,
    row: int,
    sx: float,
    sy: float,
    level_max: float,
    seen: Float32,
    at: int,
) -> int:
    """Write the mean VDF of each block of plots and its share of stale plots; return where they end.

    A plot is stale if its VDF is at most one unit below the largest. Plots outside the field count as fresh.
    """
    per_level, per_plot, columns, rows = 1.0 / (BLOCK * BLOCK * level_max), 1.0 / (BLOCK * BLOCK), *level.shape
    half = BLOCKS // 2
    for block_x in range(-half, half + 1):
        west, east = block_ends(column, sx, block_x, columns)
        for block_y in range(-half, half + 1):
            south, north = block_ends(row, sy, block_y, rows)
            stale = 0
            for i in range(west, east):
                for j in range(south, north):
                    stale += level[i, j] >= level_max - 1.0
            seen[at] = _sum(above, west, east, south, north) * per_level
            seen[at + BLOCKS * BLOCKS] = stale * per_plot
            at += 1
    return at + BLOCKS * BLOCKS


@allocation_free
def put_cells(
    above: Array, column: int, row: int, sx: float, sy: float, level_max: float, seen: Float32, at: int
) -> int:
    """Write the AoI of the sensor cells around and of blocks of them, clipped at 1; return where they end."""
    columns, rows, half = above.shape[1], len(above) - 1, CELLS // 2
    scale = 1.0 / (2.0 * level_max)
    for step_x in range(-half, half + 1):
        for step_y in range(-half, half + 1):
            i, j = column + int(sx) * step_x, row + int(sy) * step_y
            amount = 0.0
            if 0 <= i < columns and 0 <= j < rows:
                amount = max(0.0, above[j, i] - above[j + 1, i])
            seen[at] = min(1.0, amount * scale)
            at += 1
    scale, half = 1.0 / (2.0 * BLOCK * BLOCK * level_max), BLOCKS // 2
    for block_x in range(-half, half + 1):
        west, east = block_ends(column, sx, block_x, columns)
        for block_y in range(-half, half + 1):
            south, north = block_ends(row, sy, block_y, rows)
            seen[at] = min(1.0, _sum(above, west, east, south, north) * scale)
            at += 1
    return at
