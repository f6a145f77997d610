"""Beam search for the commands of one UAV with inertia: paths are flown as the farm would fly them.

A path tries, along each axis, full speed back, to stand, to keep the present velocity and full speed on, and holds each
command for some steps.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from eia_sec.rollout.heuristics.tasks.beam import Array, Flags, Indices, closing, keep_best
from eia_sec.rollout.sim.core.compile import compiled, compiled_entry
from eia_sec.rollout.sim.core.dynamics import ACCELERATION, COMMAND, VELOCITY, glide

LEVELS: Final = 4
"""Commands to try along an axis."""
BUCKET: Final = 20.0
"""Least side of the squares in which sites are looked up, m."""
AHEAD: Final = 1.5
"""Paths that would be in the same cell so much later are alike, s."""
CELL: Final = 8.0
"""Least side of these cells, m."""


class Sites(NamedTuple):
    """What a UAV serves, and how well from how far.

    Attributes:
        place: [S, 2] m.
        first: [C + 1] first entry of each square in `item`, x outer.
        item: [S] sites by squares.
        columns: squares along x.
        rows: squares along y.
        width: of a square, m.
        depth: of a square, m.
        chance: [K, K] probability of service at equal steps of the distances along x and along y, from 0.
        limit: distance along an axis from which there is none, m.
    """

    place: Array
    first: Indices
    item: Indices
    columns: int
    rows: int
    width: float
    depth: float
    chance: Array
    limit: float


class Limits(NamedTuple):
    """Of the UAV, and the field.

    Attributes:
        most: acceleration, m/s^2.
        jerk: m/s^3.
        delay: s.
        top_x: m/s.
        top_y: m/s.
        seconds: of a step.
        field_x: m.
        field_y: m.
    """

    most: float
    jerk: float
    delay: float
    top_x: float
    top_y: float
    seconds: float
    field_x: float
    field_y: float


class Reward(NamedTuple):
    """Of a step: for a unit served, for none, for a metre of closing in within `safety`, and for the border."""

    unit: float
    idle: float
    risk: float
    safety: float
    boundary: float
    discount: float


@compiled
def _serve(sites: Sites, level: Array, rest: Array, x: float, y: float, take: bool) -> float:
    """Return the units that a step ending at a place serves; take them away if asked."""
    total, reach = 0.0, sites.limit
    left, right = int(max(0.0, (x - reach) // sites.width)), int(min(sites.columns - 1.0, (x + reach) // sites.width))
    low, high = int(max(0.0, (y - reach) // sites.depth)), int(min(sites.rows - 1.0, (y + reach) // sites.depth))
    scale = len(sites.chance) / reach
    for column in range(left, right + 1):
        for entry in range(sites.first[column * sites.rows + low], sites.first[column * sites.rows + high + 1]):
            site = sites.item[entry]
            dx, dy = abs(sites.place[site, 0] - x), abs(sites.place[site, 1] - y)
            if dx < reach and dy < reach:
                chance = sites.chance[int(dx * scale), int(dy * scale)]
                total += level[site] * rest[site] * chance
                if take:
                    rest[site] *= 1.0 - chance
    return total


@compiled
def _fly(limits: Limits, axis: int, place: float, motion: Array, levels: int, out: Array) -> None:
    """Write for each level of an axis: place, velocity, acceleration, command, and 1 if the border stops it; [L, 5].

    A single level is the last command.
    """
    top = limits.top_x if axis == 0 else limits.top_y
    side = limits.field_x if axis == 0 else limits.field_y
    v, a = motion[VELOCITY + axis], motion[ACCELERATION + axis]
    first, v0, a0 = glide(v, a, motion[COMMAND + axis], limits.most, limits.jerk, limits.delay)
    for level in range(levels):
        command = v if level == LEVELS - 1 else (level - 1.0) * top
        if levels == 1:
            command = motion[COMMAND + axis]
        way, then, end = glide(v0, a0, command, limits.most, limits.jerk, limits.seconds - limits.delay)
        to = place + first + way
        out[level, 0], out[level, 1], out[level, 2], out[level, 3], out[level, 4] = to, then, end, command, 0.0
        if to < 0.0 or to > side:
            out[level, 0] = min(side, max(0.0, to))
            out[level, 1], out[level, 2], out[level, 3], out[level, 4] = 0.0, 0.0, 0.0, 1.0


@compiled
def _cell(limits: Limits, columns: int, rows: int, x: Array, y: Array) -> int:
    """Return the cell in which a path would be soon."""
    across = min(columns - 1.0, max(0.0, (x[0] + AHEAD * x[1]) / limits.field_x * columns))
    along = min(rows - 1.0, max(0.0, (y[0] + AHEAD * y[1]) / limits.field_y * rows))
    return int(across) * rows + int(along)


@compiled_entry
def best_commands(
    sites: Sites,
    limits: Limits,
    reward: Reward,
    position: Array,
    motion: Array,
    level: Array,
    claimed: Array,
    others: Array,
    barred: Flags,
    width: int,
    same: int,
    hold: int,
) -> tuple[Array, Array]:
    """Return the commands of the best path that a beam search finds, and the places that they lead to.

    Args:
        sites: what is served.
        limits: of the UAV.
        reward: of a step.
        position: [2] m.
        motion: [6] velocity, acceleration and last command.
        level: [H, S] counters that each of the H steps would credit if no UAV served anything.
        claimed: [M, 2] places on the plans of the other UAVs, m; what they serve does not count here.
        others: [H + 1, m, 2] positions of the other UAVs now and after each step, m.
        barred: [columns, rows] cells that no step may end in; empty where all are free.
        width: number of paths to keep.
        same: number of kept paths that may be in one cell.
        hold: steps for which a path holds each command.

    Returns:
        [H, 2] m/s and [H, 2] m.
    """
    horizon, site_count = level.shape
    columns, rows = max(1, int(limits.field_x / CELL)), max(1, int(limits.field_y / CELL))
    rest = np.ones((1, site_count))
    for k in range(len(claimed)):
        _serve(sites, level[0], rest[0], claimed[k, 0], claimed[k, 1], True)
    place, moving, score = np.zeros((1, 2)), np.zeros((1, 6)), np.zeros(1)
    place[0], moving[0] = position, motion
    commands, path = np.zeros((1, horizon, 2)), np.zeros((1, horizon, 2))
    outcome = np.zeros((width, 2, LEVELS, 5))
    candidate, cell = np.empty(width * LEVELS * LEVELS), np.empty(width * LEVELS * LEVELS, np.int64)
    used, chosen, factor = np.zeros(columns * rows, np.int64), np.empty(width, np.int64), 1.0
    to = np.empty(2)
    for step in range(horizon):
        levels = LEVELS if step % hold == 0 else 1
        options = levels * levels
        for b in range(len(score)):
            _fly(limits, 0, place[b, 0], moving[b], levels, outcome[b, 0])
            _fly(limits, 1, place[b, 1], moving[b], levels, outcome[b, 1])
            for option in range(options):
                x, y = outcome[b, 0, option // levels], outcome[b, 1, option % levels]
                value = -np.inf
                column = int(min(columns - 1.0, x[0] / limits.field_x * columns))
                row = int(min(rows - 1.0, y[0] / limits.field_y * rows))
                if len(barred) == 0 or not barred[column, row]:
                    units = _serve(sites, level[step], rest[b], x[0], y[0], False)
                    value = reward.unit * units + (reward.idle if units < 0.5 else 0.0)
                    value += reward.boundary * max(x[4], y[4])
                    to[0], to[1] = x[0], y[0]
                    value += reward.risk * closing(to, place[b], others[step + 1], others[step], reward.safety)
                candidate[b * options + option] = score[b] + factor * value
                cell[b * options + option] = _cell(limits, columns, rows, x, y)
        count = len(score) * options
        kept = keep_best(candidate[:count], cell[:count], width, same, used, chosen)
        parent = chosen[:kept] // options
        score, rest, commands, path = candidate[chosen[:kept]], rest[parent], commands[parent], path[parent]
        place, moving = np.empty((kept, 2)), np.empty((kept, 6))
        for k in range(kept):
            b, option = chosen[k] // options, chosen[k] % options
            for axis in range(2):
                end = outcome[b, axis, option // levels if axis == 0 else option % levels]
                place[k, axis], moving[k, VELOCITY + axis] = end[0], end[1]
                moving[k, ACCELERATION + axis], moving[k, COMMAND + axis] = end[2], end[3]
                commands[k, step, axis], path[k, step, axis] = end[3], end[0]
            _serve(sites, level[step], rest[k], place[k, 0], place[k, 1], True)
        factor *= reward.discount
    return commands[0].copy(), path[0].copy()


def make_sites(place: NDArray[np.float64], field: tuple[float, float], chance: Array, limit: float) -> Sites:
    """Return sites [S, 2] m of a field, served with probabilities `chance` [K, K]; see `Sites`."""
    columns, rows = (max(1, int(side / BUCKET)) for side in field)
    width, depth = field[0] / columns, field[1] / rows
    across = np.minimum(columns - 1, (place[:, 0] / width).astype(np.int64))
    along = np.minimum(rows - 1, (place[:, 1] / depth).astype(np.int64))
    square = across * rows + along
    item = np.argsort(square, kind="stable").astype(np.int64)
    first = np.searchsorted(square[item], np.arange(columns * rows + 1)).astype(np.int64)
    return Sites(np.ascontiguousarray(place), first, item, columns, rows, width, depth, chance, float(limit))
