"""What the best plan that begins with each of nine moves is worth, by beam search.

A plan is a path over lattice points. A step over a point brings the expected units of the counters that are served
from there, less what the step costs: energy, and P_M or P_C if it brings next to nothing. Each plan has counters of its
own, which fall where it serves them and rise when they are due. A site belongs to the UAV of the type that is nearest
to it now, and plans leave out what belongs to others; so a UAV need not know what they plan. The search
keeps the best plan of each first move, and of all others the best; no two have the same first move and the same end.
Plans lead round no-fly zones, and none begins with a move that a zone refuses.

Source: receding-horizon control with beam search over a grid, as in informative path planning (Binney and Sukhatme
2012). That an agent sees what a search found is as in imagination-augmented agents (Racaniere et al. 2017).
"""

import math
from typing import Final

import numpy as np

from eia_sec.rollout.sim.conditions.ways import is_barred
from eia_sec.rollout.sim.core.compile import allocation_free
from eia_sec.rollout.sim.core.records import Array, Flags, Float32, Indices, Int32, Site, Steps
from eia_sec.rollout.sim.observation.plans.arrays import PlanScratch
from eia_sec.rollout.sim.observation.plans.constants import DISCOUNT

ONE: Final = np.float32(1.0)

NOTHING: Final = 0.5
"""Units of a step below which P_M or P_C is due."""
MOVES: Final = 16
"""A plan's name is that many times its end, and its first move."""


@allocation_free
def _units(first: Int32, site: Site, chance: Float32, level: Float32, point: int) -> float:
    """Return the units that a step over a lattice point is expected to bring."""
    units = 0.0
    for entry in range(first[point], first[point + 1]):
        units += np.float64(level[site[entry]]) * np.float64(chance[entry])
    return units


@allocation_free
def _serve(first: Int32, site: Site, chance: Float32, level: Float32, point: int) -> None:
    """Lower the counters that a step over a lattice point serves, on average."""
    for entry in range(first[point], first[point + 1]):
        j = site[entry]
        level[j] = np.float32(np.float64(level[j]) * (1.0 - np.float64(chance[entry])))


@allocation_free
def _rise(rising: Site, count: int, most: np.float32, level: Float32) -> None:
    """Raise the counters that are due."""
    for entry in range(count):
        level[rising[entry]] = min(most, level[rising[entry]] + ONE)


@allocation_free
def _copy(count: int, source: Float32, target: Float32) -> None:
    for site in range(count):
        target[site] = source[site]


@allocation_free
def _extend(
    columns: int,
    rows: int,
    factor: float,
    turn_x: int,
    turn_y: int,
    column: int,
    row: int,
    score: float,
    first: Int32,
    site: Site,
    chance: Float32,
    costs: Array,
    barred: Steps,
    level: Float32,
    worth: Array,
    end: Indices,
) -> int:
    """Extend a plan by each of nine moves; return how many of them stay in the field and are not barred.

    Writes what the extended plans are worth, in units, and the lattice points at which they end.
    """
    count = 0
    for move_x in range(-1, 2):
        x = column + turn_x * move_x
        if x < 0 or x >= columns:
            continue
        for move_y in range(-1, 2):
            y = row + turn_y * move_y
            if y < 0 or y >= rows:
                continue
            if len(barred) > 0 and is_barred(barred, column * rows + row, turn_x * move_x, turn_y * move_y):
                continue
            units = _units(first, site, chance, level, x * rows + y)
            cost = costs[2 * (move_x & 1) + (move_y & 1)] + (costs[4] if units < NOTHING else 0.0)
            worth[count], end[count] = score + factor * (units - cost), x * rows + y
            count += 1
    return count


@allocation_free
def _rank(worth: float, name: int, parent: int, count: int, value: Array, names: Indices, parents: Indices) -> int:
    """Take an extended plan into the list of the best, in descending order; return how many are listed.

    Of plans with the same name only the best stays, and of equal plans the first one. The loop over the names has no
    branch, so that it compares several at once.

    Args:
        worth: of the plan, in units.
        name: its end and its first move, as one number.
        parent: the plan that it extends.
        count: plans that are listed.
        value: [W] their worths.
        names: [W] their names.
        parents: [W] the plans that they extend.
    """
    if count == len(value) and worth <= value[count - 1]:
        return count
    place = count
    for k in range(count):
        place = k if names[k] == name else place
    if place < count:
        if worth <= value[place]:
            return count
    elif count < len(value):
        count += 1
    else:
        place = count - 1
    while place > 0 and value[place - 1] < worth:
        value[place], names[place], parents[place] = value[place - 1], names[place - 1], parents[place - 1]
        place -= 1
    value[place], names[place], parents[place] = worth, name, parent
    return count


@allocation_free
def _choose(plan: PlanScratch, count: int, stopped: Flags, worth: Array) -> int:
    """Choose the best plan of each first move, and the best others from the list, in this order; return how many.

    Best plans that are not listed come last.

    Args:
        plan: `value`, `names`, `parents`, `best` and `lead`; the function writes `chosen`.
        count: plans that are listed.
        stopped: [9] moves with which no plan begins.
        worth: [W] out: what the chosen plans are worth.
    """
    others, kept, led = len(worth), 0, 0
    for move in range(9):
        others -= 0 if stopped[move] else 1
    for place in range(count):
        mark = 1 << (plan.names[place] % MOVES)
        if led & mark == 0:
            led |= mark  # the first of its first move in the list is its best
        elif others > 0:
            others -= 1
        else:
            continue
        plan.chosen[0, kept], plan.chosen[1, kept] = plan.names[place], plan.parents[place]
        worth[kept] = plan.value[place]
        kept += 1
    for move in range(9):
        if led & (1 << move) == 0 and not stopped[move]:
            plan.chosen[0, kept], plan.chosen[1, kept] = plan.lead[0, move], plan.lead[1, move]
            worth[kept] = plan.best[move]
            kept += 1
    return kept


@allocation_free
def _begin(
    columns: int,
    rows: int,
    column: int,
    row: int,
    turn_x: int,
    turn_y: int,
    stopped: Flags,
    sites: int,
    most: np.float32,
    plan: PlanScratch,
) -> int:
    """Make a plan of one step for each of nine moves that no zone refuses, and return how many these are.

    Arguments are as for `search`.
    """
    first, site, chance = plan.first, plan.site, plan.chance
    count = 0
    for move in range(9):
        if stopped[move]:
            plan.best[move] = -math.inf
            continue
        x = min(columns - 1, max(0, column + turn_x * (move // 3 - 1)))
        y = min(rows - 1, max(0, row + turn_y * (move % 3 - 1)))
        to, level = x * rows + y, plan.level[0, count]
        _copy(sites, plan.own, level)
        units = _units(first, site, chance, level, to)
        cost = plan.costs[2 * abs(x - column) + abs(y - row)] + (plan.costs[4] if units < NOTHING else 0.0)
        plan.move[0, count], plan.end[0, count], plan.score[0, count] = move, to, units - cost
        plan.best[move] = units - cost
        _rise(plan.rising[0], plan.risen[0], most, level)
        _serve(first, site, chance, level, to)
        count += 1
    return count


@allocation_free
def _extend_all(
    columns: int,
    rows: int,
    now: int,
    turn_x: int,
    turn_y: int,
    kept: int,
    factor: float,
    barred: Steps,
    plan: PlanScratch,
) -> int:
    """Extend all plans by one step, and list the best; note the best of each first move; return how many are listed.

    Args:
        columns: lattice points along x.
        rows: lattice points along y.
        now: 0 or 1, which half of the working memory holds the plans.
        turn_x: see `search`.
        turn_y: see `search`.
        kept: plans there are.
        factor: discount of the step.
        barred: see `search`.
        plan: working memory.
    """
    listed = 0
    plan.best[:] = -math.inf
    for parent in range(kept):
        point, move = plan.end[now, parent], plan.move[now, parent]
        found = _extend(
            columns,
            rows,
            factor,
            turn_x,
            turn_y,
            point // rows,
            point % rows,
            plan.score[now, parent],
            plan.first,
            plan.site,
            plan.chance,
            plan.costs,
            barred,
            plan.level[now, parent],
            plan.worth,
            plan.to,
        )
        for k in range(found):
            worth, name = plan.worth[k], plan.to[k] * MOVES + move
            if worth > plan.best[move]:
                plan.best[move], plan.lead[0, move], plan.lead[1, move] = worth, name, parent
            listed = _rank(worth, name, parent, listed, plan.value, plan.names, plan.parents)
    return listed


@allocation_free
def _renew(ahead: int, listed: int, stopped: Flags, sites: int, most: np.float32, plan: PlanScratch) -> int:
    """Replace all plans by the best longer ones, whose counters rise and fall; return how many there are.

    Args:
        ahead: steps that the plans had.
        listed: longer plans that are listed.
        stopped: see `search`.
        sites: sites that matter.
        most: largest counter.
        plan: working memory.
    """
    now, then = (ahead - 1) % 2, ahead % 2
    kept = _choose(plan, listed, stopped, plan.score[then])
    for k in range(kept):
        end, level = plan.chosen[0, k] // MOVES, plan.level[then, k]
        plan.move[then, k], plan.end[then, k] = plan.chosen[0, k] % MOVES, end
        _copy(sites, plan.level[now, plan.chosen[1, k]], level)
        _rise(plan.rising[ahead], plan.risen[ahead], most, level)
        _serve(plan.first, plan.site, plan.chance, level, end)
    return kept


@allocation_free
def search(
    columns: int,
    rows: int,
    steps: int,
    column: int,
    row: int,
    turn_x: int,
    turn_y: int,
    stopped: Flags,
    barred: Steps,
    sites: int,
    most: np.float32,
    plan: PlanScratch,
) -> None:
    """Find the worth of the best plan that begins with each of nine moves.

    Args:
        columns: lattice points along x.
        rows: lattice points along y.
        steps: steps that plans look ahead; 0 makes all plans worth nothing.
        column: of the UAV's lattice point.
        row: of its lattice point.
        turn_x: 1 or -1, the direction of its own axis along x.
        turn_y: the same along y.
        stopped: [9] whether a zone refuses each move; no plan begins with such a move, and its worth is -inf.
        barred: [K] barred steps from each lattice point, see `conditions.ways`; [0] if there is none.
        sites: sites that matter.
        most: largest counter.
        plan: `own`, `rising`, `risen`, `first`, `site`, `chance` and `costs`; the function writes the rest.
    """
    if steps == 0:
        for move in range(9):
            plan.best[move] = -math.inf if stopped[move] else 0.0
        return
    kept = _begin(columns, rows, column, row, turn_x, turn_y, stopped, sites, most, plan)
    factor = 1.0
    for ahead in range(1, steps):
        factor *= DISCOUNT
        listed = _extend_all(columns, rows, (ahead - 1) % 2, turn_x, turn_y, kept, factor, barred, plan)
        kept = _renew(ahead, listed, stopped, sites, most, plan) if ahead + 1 < steps else 0
