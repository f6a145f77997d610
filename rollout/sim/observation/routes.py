"""The sweep route of a monitoring UAV: which of nine moves follows it, and where its next plots are.

`sweep` holds a UAV's route and the box on it that comes next. The box counts as reached when the UAV is in it. A plot
with VDF 0 is passed over, unless all plots have VDF 0; so is one that no-fly zones shut off. The suggested move comes
nearest to the next box, among zones by the steps of the way round them. Of several moves that reach it, the one nearest
to the box after it is suggested; of equals, the shortest. A move that a zone refuses is never suggested.
"""

import math
from typing import Final

from eia_sec.common.farm_observation import ROUTE_OFFSET, ROUTE_PLOTS
from eia_sec.rollout.sim.boxes import ROUNDING
from eia_sec.rollout.sim.conditions.ways import UNKNOWN, WayConstants, steps_to_plot
from eia_sec.rollout.sim.core.arrays import Farm, Scratch
from eia_sec.rollout.sim.core.compile import allocation_free, inlined
from eia_sec.rollout.sim.core.constants import Constants
from eia_sec.rollout.sim.core.records import Array, Flags, Float32, Indices, Int32
from eia_sec.rollout.sim.core.tallies import total

STAY: Final = 4
"""The move that leads nowhere."""
PER_GAP: Final = 1e3
"""Weight of a metre to the box after the next, beside a square metre of way; the next box has the square of it."""
PER_OFFSET: Final = 0.05
"""1 / offset to a plot that is observed as 1, 1/m (ours)."""
NUMBERS: Final = 9 + 2 * ROUTE_PLOTS
"""Numbers that say where the route leads."""


@allocation_free
def _gap(box: Array, x: float, y: float) -> float:
    """Return how far a place is from a box along the worse axis, m."""
    gap: float = max(0.0, box[0] - x, x - box[1], box[2] - y, y - box[3])
    return gap


@allocation_free
def _advance(
    sweep: Int32,
    box: Array,
    plot: Indices,
    first: int,
    count: int,
    level: Array,
    some: bool,
    closed: Flags,
    x: float,
    y: float,
) -> None:
    """Let the next box be the first one from the present next box on that is not done and not closed.

    Args:
        sweep: [2] the UAV's route and the box that comes next; the function updates the latter.
        box: [T, 4] the boxes of all routes, m.
        plot: [T] their plots, row-major.
        first: first box of the route.
        count: boxes of the route.
        level: [n_px, n_py] VDF.
        some: whether any plot has a VDF above 0.
        closed: [P] whether zones shut each plot off; [0] without zones.
        x: of the UAV, m.
        y: of the UAV, m.
    """
    rows = level.shape[1]
    for turn in range(count):
        at = first + sweep[1]
        passed = some and level[plot[at] // rows, plot[at] % rows] == 0.0
        if len(closed) > 0:
            passed |= closed[plot[at]]
        if not passed and not (turn == 0 and _gap(box[at], x, y) <= ROUNDING):
            return
        sweep[1] = (sweep[1] + 1) % count


@allocation_free
def _find_ends(ways: WayConstants, go_x: Array, go_y: Array, stopped: Flags, ends: Int32) -> None:
    """Write the lattice points in whose cells the moves end, [9]; of a move that a zone refuses that of another one."""
    possible = 0
    for move in range(9):
        if not stopped[move]:
            possible = move
    for move in range(9):
        flown = possible if stopped[move] else move
        ends[move] = _point(ways, go_x[flown // 3], go_y[flown % 3])


@allocation_free
def _count_steps(steps: Int32, ends: Int32, box: Array, go_x: Array, go_y: Array, away: Array) -> None:
    """Write how many steps of the way round zones each move leaves to a box.

    Args:
        steps: [K] steps from each lattice point to the box's plot.
        ends: [9] points in whose cells the moves end.
        box: [4] least and largest x, least and largest y, m.
        go_x: [3] x after each move along the UAV's own axis, m.
        go_y: [3] the same along y, m.
        away: [9] out.
    """
    for move in range(9):
        found = steps[ends[move]]
        away[move] = len(steps) if found == UNKNOWN else found
        if _gap(box, go_x[move // 3], go_y[move % 3]) <= ROUNDING:
            away[move] = 0.0


@allocation_free
def _point(ways: WayConstants, x: float, y: float) -> int:
    """Return the lattice point in whose cell a place lies."""
    column, row = min(ways.columns - 1, int(x / ways.width)), min(ways.rows - 1, int(y / ways.depth))
    return column * ways.rows + row


@allocation_free
def _suggested(
    box: Array, onward: Array, x: float, y: float, go_x: Array, go_y: Array, stopped: Flags, away: Array
) -> int:
    """Return the move that follows the route.

    Args:
        box: [4] the next box on the route: least and largest x, least and largest y, m.
        onward: [4] the box after it.
        x: of the UAV, m.
        y: of the UAV, m.
        go_x: [3] x after each move along the UAV's own axis, m.
        go_y: [3] the same along y, m.
        stopped: [9] whether a zone refuses each move.
        away: [9] steps of the way round zones from each move's end to the next box; 0 without zones.
    """
    nearest, least, chosen = math.inf, math.inf, STAY
    for move in range(9):
        if stopped[move]:
            continue
        to_x, to_y = go_x[move // 3], go_y[move % 3]
        gap = _gap(box, to_x, to_y)
        cost = PER_GAP * _gap(onward, to_x, to_y) if gap <= ROUNDING else PER_GAP * PER_GAP * gap
        dx, dy = to_x - x, to_y - y
        cost += dx * dx + dy * dy
        if away[move] < nearest or (away[move] == nearest and cost < least):
            nearest, least, chosen = away[move], cost, move
    return chosen


@allocation_free
def _put_offsets(
    sweep: Int32, box: Array, first: int, count: int, x: float, y: float, sx: float, sy: float, seen: Float32, at: int
) -> int:
    """Write the offsets to the next plots on the route; return where they end."""
    for ahead in range(ROUTE_PLOTS):
        corners = box[first + (sweep[1] + ahead) % count]
        dx, dy = 0.5 * (corners[0] + corners[1]) - x, 0.5 * (corners[2] + corners[3]) - y
        seen[at], seen[at + 1] = (
            sx * min(ROUTE_OFFSET, max(-ROUTE_OFFSET, dx * PER_OFFSET)),
            sy * min(ROUTE_OFFSET, max(-ROUTE_OFFSET, dy * PER_OFFSET)),
        )
        at += 2
    return at


@inlined
def put_route(c: Constants, farm: Farm, s: Scratch, u: int, at: int) -> int:
    """Write which move follows the route, and the offsets to the next plots on it; return where they end.

    Updates the box that comes next.
    """
    view, v, ways, sweep = c.added, s.added, c.ways, farm.sweep[u - c.fleet.relays]
    x, y, go_x, go_y = farm.position[u, 0], farm.position[u, 1], s.added.go_x[u], s.added.go_y[u]
    box, plot, first = view.route_box, view.route_plot, view.route_start[sweep[0]]
    count = view.route_start[sweep[0] + 1] - first
    _advance(sweep, box, plot, first, count, farm.level, total(farm.level_above) > 0.0, farm.closed, x, y)
    following, goal = first + (sweep[1] + 1) % count, first + sweep[1]
    if ways.some:
        _find_ends(ways, go_x, go_y, v.stopped, v.ends)
        steps_to_plot(ways, farm.barred, plot[goal], v.ends, s.way_steps, s.way_queue)
        _count_steps(s.way_steps, v.ends, box[goal], go_x, go_y, v.away)
    chosen = _suggested(box[goal], box[following], x, y, go_x, go_y, v.stopped, v.away)
    for move in range(9):
        farm.observation[at + move] = 1.0 if move == chosen else 0.0
    return _put_offsets(
        sweep, box, first, count, x, y, s.added.sign[u, 0], s.added.sign[u, 1], farm.observation, at + 9
    )
