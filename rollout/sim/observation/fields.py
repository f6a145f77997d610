"""Value fields: how much of a task lies around each of nine places, and how much of it is this UAV's own.

F(x) = sum_i s_i v_i exp(-|x - p_i|_1 / L) over the plots' centres or the sensor cells' centres p_i. v_i is the level
there over the largest; s_i = d_p^2 / (d^2 + d_p^2) is the UAV's own share, with its distance d and that of the nearest
other UAV of its type, d_p. The far field multiplies v_i by min(v_i, 1), so that stale places count more there. The
exponential is a product of one factor per axis, and the near one is a power of the far one.
"""

import math
from typing import Final

import numpy as np

from eia_sec.common.farm_observation import FIELD_SCALE
from eia_sec.rollout.sim.core.compile import allocation_free, inlined
from eia_sec.rollout.sim.core.constants import FleetConstants
from eia_sec.rollout.sim.core.logarithm import vectorisable_log
from eia_sec.rollout.sim.core.records import Array, Float32
from eia_sec.rollout.sim.observation.arrays import FieldScratch
from eia_sec.rollout.sim.observation.constants import RATIO

FLOOR: Final = 1e-3
"""Added to a field before the logarithm, so that an empty one has no direction (ours)."""
ALONE: Final = np.float32(1e30)
"""Square of the distance to a UAV that does not exist, m^2."""
TINY: Final = np.float32(1e-9)
"""Added to squares of distances, so that UAVs at one point share it, m^2."""


@allocation_free
def weigh_points(above: Array, per_level: float, field: FieldScratch) -> None:
    """Write both weights of every point, from the tally of its levels."""
    filled = len(field.x) // (len(above) - 1)
    for row in range(len(above) - 1):
        value, stale = field.value[row * filled :], field.stale[row * filled :]
        for column in range(above.shape[1]):
            level = max(0.0, above[row, column] - above[row + 1, column]) * per_level
            value[column], stale[column] = level, level * min(level, 1.0)


@allocation_free
def share_points(x: Array, y: Array, field: FieldScratch) -> None:
    """Find the distances of the nearest and the second nearest UAV of a type at every point.

    Args:
        x: [n_v] positions of the type along x, m.
        y: [n_v] the same along y, m.
        field: the points; the function writes `first` and `second`.
    """
    field.first[:], field.second[:] = ALONE, ALONE
    for u in range(len(x)):
        _add_uav(np.float32(x[u]), np.float32(y[u]), field.x, field.y, field.first, field.second)


@allocation_free
def _add_uav(x: np.float32, y: np.float32, point_x: Float32, point_y: Float32, low: Float32, high: Float32) -> None:
    """Let one UAV count as nearest or second nearest at every point, several at once."""
    for point in range(len(low)):
        dx, dy = point_x[point] - x, point_y[point] - y
        square = dx * dx + dy * dy
        high[point] = min(high[point], max(low[point], square))
        low[point] = min(low[point], square)


@allocation_free
def _spread(side: float, width: float, here: float, go: Array, powers: Array, far: Float32, near: Float32) -> None:
    """Write exp(-d / range) between the points along an axis and a UAV's three places and its own, [4, points]."""
    for place in range(4):
        x = here if place == 3 else go[place]
        rise = math.exp((x - 0.5 * side) / width)
        fall = 1.0 / rise
        for point in range(powers.shape[1]):
            factor = min(rise * powers[1, point], fall * powers[0, point])
            far[place, point], near[place, point] = factor, factor**RATIO


@allocation_free
def _take_share(
    x: np.float32,
    y: np.float32,
    point_x: Float32,
    point_y: Float32,
    first: Float32,
    second: Float32,
    value: Float32,
    stale: Float32,
    own: Float32,
    old: Float32,
) -> None:
    """Write a UAV's own share of both weights of every point, several at once.

    Where the UAV is the nearest of its type, its distance is the least, and the second nearest is its rival.
    """
    for point in range(len(own)):
        dx, dy = point_x[point] - x, point_y[point] - y
        apart = dx * dx + dy * dy
        rival = (second[point] if apart <= first[point] else first[point]) + TINY
        share = rival / (apart + TINY + rival)
        own[point], old[point] = share * value[point], share * stale[point]


@allocation_free
def _sum_rows(along: Float32, weight: Float32, sums: Float32) -> None:
    """Sum weights [R C'] over the rows, times each of four factors [4, R] along y: [4, C']."""
    sums[:, :] = 0.0
    filled = sums.shape[1]
    for row in range(along.shape[1]):
        amount = weight[row * filled :]
        for place in range(4):
            for column in range(filled):
                sums[place, column] += along[place, row] * amount[column]


@allocation_free
def _sum_columns(across: Float32, sums: Float32, total: Array) -> None:
    """Sum up a field at the nine places and at the UAV's, [16]."""
    total[:] = 0.0
    for column in range(across.shape[1]):
        for place in range(9):
            total[place] += across[place // 3, column] * sums[place % 3, column]
        total[9] += across[3, column] * sums[3, column]


@inlined
def put_field(
    fleet: FleetConstants,
    x: float,
    y: float,
    go_x: Array,
    go_y: Array,
    powers_x: Array,
    powers_y: Array,
    width: float,
    per_reach: float,
    field: FieldScratch,
    seen: Float32,
    at: int,
) -> int:
    """Write both fields as a UAV sees them, ten numbers each; return where they end.

    Args:
        fleet: the field.
        x: of the UAV, m.
        y: of the UAV, m.
        go_x: [3] x after each move along the UAV's own axis, m.
        go_y: [3] the same along y, m.
        powers_x: [2, C] see `ViewConstants`.
        powers_y: [2, R] see `ViewConstants`.
        width: range of the far field, m.
        per_reach: 1 / longest move, both axes added up, 1/m.
        field: weights and distances of all points.
        seen: row of observations.
        at: where to begin in it.
    """
    _spread(fleet.width, width, x, go_x, powers_x, field.across[1], field.across[0])
    _spread(fleet.depth, width, y, go_y, powers_y, field.along[1], field.along[0])
    own, old = field.weight[0], field.weight[1]
    _take_share(
        np.float32(x), np.float32(y), field.x, field.y, field.first, field.second, field.value, field.stale, own, old
    )
    for kind in range(2):
        total = field.total[kind]
        _sum_rows(field.along[kind], field.weight[kind], field.sums)
        _sum_columns(field.across[kind], field.sums, total)
        total[10] = total[9] * FLOOR
        _take_logarithms(total)
        scale = width * per_reach / (RATIO if kind == 0 else 1.0)
        for move in range(9):
            seen[at + move] = (total[move] - total[9]) * scale
        seen[at + 9] = total[10] * FIELD_SCALE
        at += 10
    return at


@allocation_free
def _take_logarithms(total: Array) -> None:
    """Replace every number by ln(1 + number / FLOOR), several at once."""
    for place in range(len(total)):
        total[place] = vectorisable_log(1.0 + total[place] * (1.0 / FLOOR))
