"""The sweep route of a monitoring UAV: which of nine moves follows it, and where its next plots are.

`sweep` holds a UAV's route and the box on it that comes next. The box counts as reached when the UAV is in it. A plot
with VDF 0 is passed over, unless all plots have VDF 0. The suggested move comes nearest to the next box. Of several
moves that reach it, the one nearest to the box after it is suggested; of equals, the shortest.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from common.farm import ROUTE_PLOTS
from rollout.sim.boxes import ROUNDING
from rollout.sim.kernel.compiler.decorators import allocation_free
from rollout.sim.kernel.constants import Array, Indices, Int32

Float32 = NDArray[np.float32]

STAY: Final = 4
"""The move that leads nowhere."""
PER_GAP: Final = 1e3
"""Weight of a metre to the box after the next, beside a square metre of way; the next box has the square of it."""
PER_OFFSET: Final = 0.05
"""1 / offset to a plot that is observed as 1, 1/m (ours)."""
MOST_OFFSET: Final = 2.0
"""Largest offset that is observed (ours)."""
NUMBERS: Final = 9 + 2 * ROUTE_PLOTS
"""Numbers that say where the route leads."""


@allocation_free
def _gap(box: Array, x: float, y: float) -> float:
    """Return how far a place is from a box along the worse axis, m."""
    gap: float = max(0.0, box[0] - x, x - box[1], box[2] - y, y - box[3])
    return gap


@allocation_free
def _advance(
    sweep: Int32, box: Array, plot: Indices, first: int, count: int, level: Array, some: bool, x: float, y: float
) -> None:
    """Let the next box be the first one from the present next box on that is not done."""
    rows = level.shape[1]
    for turn in range(count):
        at = first + sweep[1]
        fresh = some and level[plot[at] // rows, plot[at] % rows] == 0.0
        if not fresh and not (turn == 0 and _gap(box[at], x, y) <= ROUNDING):
            return
        sweep[1] = (sweep[1] + 1) % count


@allocation_free
def _suggested(box: Array, onward: Array, x: float, y: float, go_x: Array, go_y: Array) -> int:
    """Return the move that follows the route."""
    least, chosen = math.inf, STAY
    for move in range(9):
        to_x, to_y = go_x[move // 3], go_y[move % 3]
        gap = _gap(box, to_x, to_y)
        cost = PER_GAP * _gap(onward, to_x, to_y) if gap <= ROUNDING else PER_GAP * PER_GAP * gap
        dx, dy = to_x - x, to_y - y
        cost += dx * dx + dy * dy
        if cost < least:
            least, chosen = cost, move
    return chosen


@allocation_free
def put_route(
    sweep: Int32,
    box: Array,
    plot: Indices,
    start: Indices,
    level: Array,
    some: bool,
    x: float,
    y: float,
    sx: float,
    sy: float,
    go_x: Array,
    go_y: Array,
    seen: Float32,
    at: int,
) -> int:
    """Write which move follows the route, and the offsets to the next plots on it; return where they end.

    Args:
        sweep: [2] the UAV's route and the box that comes next; the function updates the latter.
        box: [T, 4] the boxes of all routes: least and largest x, least and largest y, m.
        plot: [T] their plots, row-major.
        start: [R + 1] where each route begins.
        level: [n_px, n_py] VDF.
        some: whether any plot has a VDF above 0.
        x: of the UAV, m.
        y: of the UAV, m.
        sx: sign of the UAV's own axis along x.
        sy: the same along y.
        go_x: [3] x after each move along the UAV's own axis, m.
        go_y: [3] the same along y, m.
        seen: row of observations.
        at: where to begin in it.
    """
    first = start[sweep[0]]
    count = start[sweep[0] + 1] - first
    _advance(sweep, box, plot, first, count, level, some, x, y)
    following = first + (sweep[1] + 1) % count
    chosen = _suggested(box[first + sweep[1]], box[following], x, y, go_x, go_y)
    for move in range(9):
        seen[at + move] = 1.0 if move == chosen else 0.0
    at += 9
    for ahead in range(ROUTE_PLOTS):
        corners = box[first + (sweep[1] + ahead) % count]
        dx, dy = 0.5 * (corners[0] + corners[1]) - x, 0.5 * (corners[2] + corners[3]) - y
        seen[at], seen[at + 1] = (
            sx * min(MOST_OFFSET, max(-MOST_OFFSET, dx * PER_OFFSET)),
            sy * min(MOST_OFFSET, max(-MOST_OFFSET, dy * PER_OFFSET)),
        )
        at += 2
    return at
