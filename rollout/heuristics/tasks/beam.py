"""Beam search for one UAV's path over a grid of places one step apart."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from eia_sec.rollout.sim.core.compile import compiled, compiled_entry

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]


class SearchGrid(NamedTuple):
    """Places one step apart, and the sites that a UAV can serve from each.

    Attributes:
        place: [K, 2] m, x outer.
        rows: places along y.
        first: [K + 1] first entry of each place in `site` and `chance`.
        site: plots or sensors within reach.
        chance: probability that a visit of one step serves the site.
        free: [K, 3, 3] whether a move back, none or on along x and along y is possible; no-fly zones refuse others.
    """

    place: Array
    rows: int
    first: Indices
    site: Indices
    chance: Array
    free: Flags


class StepReward(NamedTuple):
    """Reward of a step.

    Attributes:
        unit: reward for one unit served.
        idle: reward for serving nothing; not above 0.
        risk: reward for closing in by 1 m on the nearest UAV; not above 0.
        safety: distance beyond which closing in costs nothing, m.
        flight: reward for staying, moving along one axis, and moving along both; not above 0.
        discount: discount factor per step.
    """

    unit: float
    idle: float
    risk: float
    safety: float
    flight: tuple[float, float, float]
    discount: float


@compiled
def _units(grid: SearchGrid, level: Array, rest: Array, node: int) -> float:
    """Return the expected units served in one step over a place."""
    total = 0.0
    for entry in range(grid.first[node], grid.first[node + 1]):
        site = grid.site[entry]
        total += level[site] * rest[site] * grid.chance[entry]
    return total


@compiled
def _serve(grid: SearchGrid, rest: Array, node: int) -> None:
    """Subtract what a step over a place serves from the remaining shares [S]."""
    for entry in range(grid.first[node], grid.first[node + 1]):
        rest[grid.site[entry]] *= 1.0 - grid.chance[entry]


@compiled
def closing(to: Array, before: Array, others: Array, earlier: Array, safety: float) -> float:
    """Return how far a step closes in on the UAV nearest after it, m; 0 if that UAV is `safety` or more away.

    Args:
        to: place after the step, x and y first, m.
        before: the place before it.
        others: [m, 2] positions of the other UAVs after the step, m.
        earlier: [m, 2] those before it.
        safety: m.
    """
    nearest, found = safety, 0.0
    for other in range(len(others)):
        now = np.hypot(to[0] - others[other, 0], to[1] - others[other, 1])
        if now < nearest:
            then = np.hypot(before[0] - earlier[other, 0], before[1] - earlier[other, 1])
            nearest, found = now, max(0.0, then - now)
    return found


@compiled
def _expand(
    grid: SearchGrid,
    reward: StepReward,
    level: Array,
    others: Array,
    earlier: Array,
    factor: float,
    node: Indices,
    score: Array,
    rest: Array,
    candidate: Array,
    move: Indices,
) -> int:
    """Score every move of every kept path.

    Args:
        grid: places and sites.
        reward: reward of a step.
        level: [S] counters that this step would credit.
        others: [m, 2] positions of the other UAVs after the step, m.
        earlier: [m, 2] their positions before the step, m.
        factor: discount of this step.
        node: [b] last place of each path.
        score: [b] score of each path.
        rest: [b, S] share of each site that a path has not served yet.
        candidate: [9 b] out: scores of the extended paths.
        move: [9 b, 2] out: the path that each one extends, and its new place.

    Returns:
        the number of extended paths.
    """
    count, columns = 0, len(grid.place) // grid.rows
    for b in range(len(node)):
        column, row = node[b] // grid.rows, node[b] % grid.rows
        for x in range(max(0, column - 1), min(columns, column + 2)):
            for y in range(max(0, row - 1), min(grid.rows, row + 2)):
                if not grid.free[node[b], x - column + 1, y - row + 1]:
                    continue
                to = x * grid.rows + y
                units = _units(grid, level, rest[b], to)
                value = reward.unit * units + reward.flight[abs(x - column) + abs(y - row)]
                value += reward.idle if units < 0.5 else 0.0
                value += reward.risk * closing(grid.place[to], grid.place[node[b]], others, earlier, reward.safety)
                candidate[count] = score[b] + factor * value
                move[count, 0], move[count, 1] = b, to
                count += 1
    return count


@compiled
def keep_best(candidate: Array, end: Indices, width: int, same: int, used: Indices, chosen: Indices) -> int:
    """Keep the best candidates, at most `same` per end; return the number kept.

    Args:
        candidate: [n] scores.
        end: [n] number of the place that each leads to.
        width: most candidates to keep.
        same: most of them with one end.
        used: zeros for each place, and zeros again afterwards.
        chosen: [width] out: the kept ones, best first.
    """
    kept = 0
    for pick in np.argsort(-candidate):
        if used[end[pick]] < same:
            used[end[pick]] += 1
            chosen[kept] = pick
            kept += 1
            if kept == width:
                break
    for k in range(kept):
        used[end[chosen[k]]] = 0
    return kept


@compiled_entry
def best_path(
    grid: SearchGrid,
    reward: StepReward,
    start: int,
    level: Array,
    claimed: Indices,
    others: Array,
    width: int,
    same: int,
) -> Indices:
    """Return the best path that a beam search finds.

    Args:
        grid: places and sites.
        reward: reward of a step.
        start: place of the UAV.
        level: [H, S] counters that each of the H steps would credit if no UAV served anything.
        claimed: [M] places on the plans of the other UAVs; what they serve does not count here.
        others: [H + 1, m, 2] positions of the other UAVs now and after each step, m.
        width: number of paths to keep.
        same: number of kept paths that may end in one place.

    Returns:
        [H] place after each step.
    """
    horizon, sites = level.shape
    node, score, rest = np.full(1, start), np.zeros(1), np.ones((1, sites))
    for place in claimed:
        _serve(grid, rest[0], place)
    path = np.zeros((1, horizon), np.int64)
    candidate, move = np.empty(9 * width), np.empty((9 * width, 2), np.int64)
    used, chosen = np.zeros(len(grid.place), np.int64), np.empty(width, np.int64)
    factor = 1.0
    for step in range(horizon):
        count = _expand(
            grid, reward, level[step], others[step + 1], others[step], factor, node, score, rest, candidate, move
        )
        kept = keep_best(candidate[:count], move[:count, 1], width, same, used, chosen)
        score = candidate[chosen[:kept]]
        parent, node = move[chosen[:kept], 0], move[chosen[:kept], 1].copy()
        rest, path = rest[parent], path[parent]
        for k in range(kept):
            path[k, step] = node[k]
            _serve(grid, rest[k], node[k])
        factor *= reward.discount
    best: Indices = path[0].copy()
    return best
