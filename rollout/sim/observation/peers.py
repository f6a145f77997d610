"""The nearest UAVs of the own type, and the metres of safety risk that each of nine moves brings."""

import math

from eia_sec.common.farm_observation import MOST_RISK
from eia_sec.rollout.sim.core.compile import allocation_free
from eia_sec.rollout.sim.core.constants import FleetConstants
from eia_sec.rollout.sim.core.records import Array, Float32, Indices


@allocation_free
def find_near(x: Array, y: Array, u: int, first: int, last: int, wanted: int, near: Indices, square: Array) -> int:
    """List the nearest other UAVs of a type, nearest first; ties go to the lowest index.

    Args:
        x: [n] positions along x, m.
        y: [n] positions along y, m.
        u: the UAV.
        first: first UAV of the type.
        last: one past the last.
        wanted: number of UAVs to list.
        near: [64] out: the UAVs.
        square: [64] out: squares of their distances, m^2.

    Returns:
        the number of UAVs listed.
    """
    held = 0
    for other in range(first, last):
        dx, dy = x[other] - x[u], y[other] - y[u]
        apart = dx * dx + dy * dy
        if other == u or (held == wanted and apart >= square[held - 1]):
            continue
        place = held if held < wanted else wanted - 1
        held = min(held + 1, wanted)
        while place > 0 and apart < square[place - 1]:
            square[place], near[place] = square[place - 1], near[place - 1]
            place -= 1
        square[place], near[place] = apart, other
    while held > 0 and square[held - 1] == math.inf:  # those that are gone
        held -= 1
    return held


@allocation_free
def put_peers(
    fleet: FleetConstants,
    x: Array,
    y: Array,
    velocity: Array,
    u: int,
    sx: float,
    sy: float,
    found: int,
    wanted: int,
    near: Indices,
    seen: Float32,
    at: int,
) -> int:
    """Write offset, velocity and presence of the nearest UAVs, five numbers each; return where they end."""
    for rank in range(wanted):
        if rank < found:
            other = near[rank]
            seen[at], seen[at + 1] = sx * (x[other] - x[u]) * fleet.per_width, sy * (y[other] - y[u]) * fleet.per_depth
            seen[at + 2], seen[at + 3], seen[at + 4] = sx * velocity[other, 0], sy * velocity[other, 1], 1.0
        else:
            seen[at], seen[at + 1], seen[at + 2], seen[at + 3], seen[at + 4] = 0.0, 0.0, 0.0, 0.0, 0.0
        at += 5
    return at


@allocation_free
def _add_risk(
    safety: float, apart: float, own_x: Array, own_y: Array, x: float, y: float, weight: float, risk: Array
) -> None:
    """Add the weighted metres by which each of nine moves closes in on a place, where it ends in d_safety (W8)."""
    for move_x in range(3):
        dx = own_x[move_x] - x
        for move_y in range(3):
            dy = own_y[move_y] - y
            then = math.sqrt(dx * dx + dy * dy)
            risk[3 * move_x + move_y] += weight * max(0.0, apart - then) if then < safety else 0.0


@allocation_free
def _add_way(
    fleet: FleetConstants,
    apart: float,
    path_x: Array,
    path_y: Array,
    x: float,
    y: float,
    way_x: float,
    way_y: float,
    risk: Array,
) -> None:
    """Add the metres of risk of nine moves that are held, beside a peer that flies on, at the end of each step (W8)."""
    before = risk[2]
    before[:] = apart
    for step in range(len(path_x)):
        x, y = min(fleet.width, max(0.0, x + way_x)), min(fleet.depth, max(0.0, y + way_y))
        for move in range(9):
            dx, dy = path_x[step, move // 3] - x, path_y[step, move % 3] - y
            then = math.sqrt(dx * dx + dy * dy)
            if then < fleet.safety:
                risk[1, move] += max(0.0, before[move] - then)
            before[move] = then


@allocation_free
def put_risk(
    fleet: FleetConstants,
    per_hold: float,
    danger_square: float,
    step_x: float,
    step_y: float,
    x: Array,
    y: Array,
    velocity: Array,
    go_x: Array,
    go_y: Array,
    path_x: Array,
    path_y: Array,
    u: int,
    found: int,
    near: Indices,
    near_square: Array,
    risk: Array,
    seen: Float32,
    at: int,
) -> int:
    """Write the risk of each move over d_safety, added up over the two nearest peers; return where it ends.

    The first nine numbers are the mean over the peer's nine moves, the other nine are for a peer that keeps its last
    velocity; with inertia these are added up step by step on the way, for two UAVs may pass within a move. Two peers
    count, because another one may be the nearest after the step.
    """
    held = path_x.shape[1] > 0
    risk[:, :] = 0.0
    for rank in range(min(found, 2)):
        if near_square[rank] >= danger_square:
            break
        other, apart = near[rank], math.sqrt(near_square[rank])
        for move in range(9):
            goal_x, goal_y = go_x[other, move // 3], go_y[other, move % 3]
            _add_risk(fleet.safety, apart, go_x[u], go_y[u], goal_x, goal_y, 1.0 / 9.0, risk[0])
        way_x, way_y = velocity[other, 0] * step_x, velocity[other, 1] * step_y
        if held:
            _add_way(fleet, apart, path_x[u], path_y[u], x[other], y[other], way_x, way_y, risk)
        else:
            goal_x = min(fleet.width, max(0.0, x[other] + way_x))
            goal_y = min(fleet.depth, max(0.0, y[other] + way_y))
            _add_risk(fleet.safety, apart, go_x[u], go_y[u], goal_x, goal_y, 1.0, risk[1])
    per_safety = 1.0 / fleet.safety
    for move in range(9):
        seen[at + move] = risk[0, move] * (per_hold * per_safety)
        on = risk[1, move] * per_safety
        seen[at + 9 + move] = min(MOST_RISK, on) if held else on
    return at + 18
