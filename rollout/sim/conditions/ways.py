"""Ways round no-fly zones over the points of the lattice, for sweep routes and plans.

A step from one lattice point to one of its eight neighbours is barred if it leaves the field, or if a zone refuses it.
With an inset below 0.5 UAVs stand in a rectangle around a cell's middle, so the step is tried from each corner of the
one rectangle to each of the other. Whether a UAV's very next move is refused is found out from where it stands, see
`find_stopped`.
"""

import functools
from typing import Annotated, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.actions.adapters import Lattice
from eia_sec.common.config import FarmConfig
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm import COLLECTION, MONITORING, inset_of, lattice_of
from eia_sec.rollout.sim.boxes import ROUNDING
from eia_sec.rollout.sim.conditions.zones import refused
from eia_sec.rollout.sim.core.compile import allocation_free
from eia_sec.rollout.sim.core.records import Array, Flags, Int32, Steps
from eia_sec.rollout.sim.sweep_routes import plot_boxes

UNKNOWN: Final = -1
"""Steps of a way that was not found."""
MOST_POINTS: Final = 2**18
"""Most lattice points; a way is sought over all of them in each step."""


class WayConstants(NamedTuple):
    """The lattice of ways, which has no points if nothing needs them."""

    some: Annotated[bool, "whether there are zones, and sweep routes or plans that lead round them"]
    columns: Annotated[int, "lattice points along x"]
    rows: Annotated[int, "lattice points along y"]
    width: Annotated[float, "distance between those along x, m"]
    depth: Annotated[float, "the same along y, m"]
    corner: Annotated[Array, "[C, 2] corners of the rectangle in which UAVs stand, from the cell's middle, m"]
    goal_start: Annotated[Int32, "[P + 1] where the points of each plot begin in `goal`"]
    goal: Annotated[
        Int32,
        "[M] points that lie in the box of a plot on a sweep route, and the one whose cell holds its middle",
    ]


def way_constants(config: FarmConfig) -> WayConstants:
    """Derive the numbers of ways.

    Raises:
        ConfigError: there are more lattice points than ways are sought over.
    """
    seen, lattice = config.observation, lattice_of(config.world)
    some = config.zones.some and (seen.route or seen.plan > 0)
    columns, rows = (lattice.columns, lattice.rows) if some else (0, 0)
    if columns * rows > MOST_POINTS:
        raise ConfigError(
            f"with farm.zones, farm.observation.route and plan are for at most {MOST_POINTS} lattice points; "
            "here steps are too short for the field."
        )
    starts, goals = _goals(config) if some and seen.route else (np.zeros(1, np.int32), np.zeros(0, np.int32))
    cell = _cell(config, lattice)
    return WayConstants(
        some=some,
        columns=columns,
        rows=rows,
        width=float(cell[0]),
        depth=float(cell[1]),
        corner=_corners(config) * cell,
        goal_start=starts,
        goal=goals,
    )


def _cell(config: FarmConfig, lattice: Lattice) -> Array:
    """Return the size of a cell, [2] m."""
    return np.array([config.world.field_x / lattice.columns, config.world.field_y / lattice.rows])


@functools.lru_cache(maxsize=8)
def _goals(config: FarmConfig) -> tuple[Int32, Int32]:
    """Return where the points of each plot begin, [P + 1], and the points, [M]; see `WayConstants`."""
    lattice = lattice_of(config.world)
    cell, starts, goals = _cell(config, lattice), [0], []
    x, y = ((np.arange(count) + 0.5) * side for count, side in zip((lattice.columns, lattice.rows), cell, strict=True))
    for least, most in zip(*plot_boxes(config), strict=True):
        column, row = np.minimum(0.5 * (least + most) // cell, (lattice.columns - 1, lattice.rows - 1)).astype(np.int64)
        across = np.flatnonzero((x >= least[0] - ROUNDING) & (x <= most[0] + ROUNDING))
        along = np.flatnonzero((y >= least[1] - ROUNDING) & (y <= most[1] + ROUNDING))
        within = (across[:, None] * lattice.rows + along).reshape(-1)
        goals.append(np.union1d(within, column * lattice.rows + row))
        starts.append(starts[-1] + len(goals[-1]))
    return np.array(starts, np.int32), np.concatenate(goals).astype(np.int32)


def _corners(config: FarmConfig) -> Array:
    """Return the corners of the rectangle in which UAVs stand, as shares of a cell, [C, 2]; one if it is a point."""
    away = 0.5 - min(inset_of(config, MONITORING), inset_of(config, COLLECTION))
    corners = np.array([(-away, -away), (-away, away), (away, -away), (away, away)])
    return corners if away > 0.0 else corners[:1]


@allocation_free
def bar_steps(ways: WayConstants, first: NDArray[np.int64], side: Array, box: Array, barred: Steps) -> None:
    """Find the barred steps.

    Args:
        ways: the lattice.
        first: as for `refused`.
        side: as for `refused`.
        box: as for `refused`.
        barred: [K] out: bit 3 (dx + 1) + dy + 1 of a point is 1 if the step by (dx, dy) is barred.
    """
    for column in range(ways.columns):
        for row in range(ways.rows):
            near, bits = _is_near(ways, box, column, row), 0
            for move in range(9):
                to_column, to_row = column + move // 3 - 1, row + move % 3 - 1
                stays = 0 <= to_column < ways.columns and 0 <= to_row < ways.rows
                if not stays or (near and _is_refused(ways, first, side, box, column, row, to_column, to_row)):
                    bits |= 1 << move
            barred[column * ways.rows + row] = bits


@allocation_free
def _is_near(ways: WayConstants, box: Array, column: int, row: int) -> bool:
    """Return whether a cell or one beside it may touch a zone."""
    west, east = (column - 1) * ways.width, (column + 2) * ways.width
    south, north = (row - 1) * ways.depth, (row + 2) * ways.depth
    for zone in range(len(box)):
        if west <= box[zone, 2] and box[zone, 0] <= east and south <= box[zone, 3] and box[zone, 1] <= north:
            return True
    return False


@allocation_free
def _is_refused(
    ways: WayConstants,
    first: NDArray[np.int64],
    side: Array,
    box: Array,
    column: int,
    row: int,
    to_column: int,
    to_row: int,
) -> bool:
    """Return whether a zone refuses a step between lattice points, from any corner to any."""
    if column == to_column and row == to_row:
        return False
    x, y = (column + 0.5) * ways.width, (row + 0.5) * ways.depth
    to_x, to_y = (to_column + 0.5) * ways.width, (to_row + 0.5) * ways.depth
    corner = ways.corner
    for start in range(len(corner)):
        for end in range(len(corner)):
            left_x, left_y = x + corner[start, 0], y + corner[start, 1]
            if refused(first, side, box, left_x, left_y, to_x + corner[end, 0], to_y + corner[end, 1]):
                return True
    return False


@allocation_free
def is_barred(barred: Steps, point: int, dx: int, dy: int) -> bool:
    """Return whether the step from a point by (dx, dy) is barred."""
    return (int(barred[point]) >> (3 * (dx + 1) + dy + 1)) & 1 == 1


@allocation_free
def close_plots(ways: WayConstants, barred: Steps, steps: Int32, queue: Int32, closed: Flags) -> None:
    """Find the plots that no way leads to from most of the field, the largest part whose points ways connect.

    Args:
        ways: the lattice, and the points of each plot.
        barred: [K] see `bar_steps`.
        steps: [K] working memory.
        queue: [K] working memory.
        closed: [P] out.
    """
    points, most, seed = len(barred), 0, 0
    steps[:] = UNKNOWN
    for point in range(points):
        if steps[point] == UNKNOWN:
            steps[point], queue[0] = 0, point
            found = _spread(ways, barred, 1, queue[:0], steps, queue)
            if found > most:
                most, seed = found, point
    steps[:] = UNKNOWN
    steps[seed], queue[0] = 0, seed
    _spread(ways, barred, 1, queue[:0], steps, queue)
    for plot in range(len(closed)):
        closed[plot] = True
        for entry in range(ways.goal_start[plot], ways.goal_start[plot + 1]):
            closed[plot] &= steps[ways.goal[entry]] == UNKNOWN


@allocation_free
def steps_to_plot(ways: WayConstants, barred: Steps, plot: int, ends: Int32, steps: Int32, queue: Int32) -> None:
    """Count the steps from lattice points to a plot; UNKNOWN where no way leads, and beyond the farthest of some ends.

    Args:
        ways: the lattice, and the points of each plot.
        barred: [K] see `bar_steps`.
        plot: the plot, row-major.
        ends: [9] points whose steps are wanted.
        steps: [K] out.
        queue: [K] working memory.
    """
    steps[:] = UNKNOWN
    first = ways.goal_start[plot]
    count = ways.goal_start[plot + 1] - first
    for entry in range(count):
        steps[ways.goal[first + entry]], queue[entry] = 0, ways.goal[first + entry]
    _spread(ways, barred, count, ends, steps, queue)


@allocation_free
def _spread(ways: WayConstants, barred: Steps, count: int, ends: Int32, steps: Int32, queue: Int32) -> int:
    """Count the steps from the first `count` points of a queue to others, breadth first; return how many are known.

    Args:
        ways: the lattice.
        barred: [K] see `bar_steps`.
        count: points in the queue.
        ends: [N] points after which to stop; none to go on to the last one.
        steps: [K] steps to each point; those in the queue have theirs, and the others that have none are UNKNOWN.
        queue: [K] the points; the function adds to it.
    """
    head, level = 0, UNKNOWN
    while head < count:
        point = queue[head]
        if steps[point] != level:
            level = steps[point]
            if _all_known(ends, steps):
                break
        head += 1
        bits = int(barred[point])
        for move in range(9):
            if (bits >> move) & 1 == 1:
                continue
            to = point + (move // 3 - 1) * ways.rows + move % 3 - 1
            if steps[to] == UNKNOWN:
                steps[to], queue[count] = steps[point] + 1, to
                count += 1
    return count


@allocation_free
def _all_known(ends: Int32, steps: Int32) -> bool:
    """Return whether there are ends and all have their steps."""
    for k in range(len(ends)):
        if steps[ends[k]] == UNKNOWN:
            return False
    return len(ends) > 0
