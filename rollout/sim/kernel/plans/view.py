"""Plans as monitors and data collection UAVs see them."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from rollout.sim.kernel.arrays import Farm, Scratch
from rollout.sim.kernel.compiler.decorators import allocation_free, inlined
from rollout.sim.kernel.constants import Array, Constants, FlightConstants
from rollout.sim.kernel.flight.motion import flight_power
from rollout.sim.kernel.plans.arrays import PlanScratch
from rollout.sim.kernel.plans.coming import find_owners, find_sites, know_plots, know_sensors, sort_by_point
from rollout.sim.kernel.plans.constants import PlanConstants
from rollout.sim.kernel.plans.search import search
from rollout.sim.kernel.views.places import own_point

Float32 = NDArray[np.float32]

NUMBERS: Final = 10
"""Numbers that say what plans are worth."""
SHARE: Final = 0.25
"""Loss that marks a plan with 1/e, as a share of a full item (ours)."""
LATE: Final = 3
"""Monitors who sweep along routes see plans and follow them in so many times the plans' steps at the end (ours)."""


@inlined
def prepare_plans(c: Constants, farm: Farm, s: Scratch) -> None:
    """Find what the plans of several UAVs need."""
    fleet, plots, sensors = c.fleet, s.plot_plan, s.sensor_plan
    if sees_plans(c.added.route, c.plans.steps, fleet.steps - farm.step):
        know_plots(c, farm, plots)
        find_owners(farm.position, fleet.relays, fleet.collectors, c.plans.plot_x, c.plans.plot_y, plots)
    know_sensors(c, farm, sensors)
    find_owners(farm.position, fleet.collectors, fleet.uavs, farm.sensor[0], farm.sensor[1], sensors)


@allocation_free
def step_costs(
    flight: FlightConstants,
    plans: PlanConstants,
    width: float,
    depth: float,
    seconds: float,
    energy: float,
    unit: float,
    costs: Array,
) -> None:
    """Write what staying, a step along y, one along x and one along both cost because of energy, in units.

    Args:
        flight: flight power.
        plans: the lattice.
        width: of the field, m.
        depth: of the field, m.
        seconds: of a step.
        energy: weight of the energy in the reward, 1/J; not above 0.
        unit: reward of a unit; if there is none, nothing costs anything.
        costs: [4] out.
    """
    across, along = width / (plans.columns * seconds), depth / (plans.rows * seconds)
    weight = -energy * seconds / unit if unit > 0.0 else 0.0
    costs[0], costs[1] = weight * flight_power(flight, 0.0), weight * flight_power(flight, along)
    costs[2] = weight * flight_power(flight, across)
    costs[3] = weight * flight_power(flight, math.sqrt(across * across + along * along))


@allocation_free
def sees_plans(route: bool, steps: int, left: int) -> bool:
    """Return whether a monitoring UAV sees plans: those who sweep along routes do so in the last steps only.

    Args:
        route: whether it sees a sweep route.
        steps: steps that plans look ahead.
        left: steps left.
    """
    return steps > 0 and not (route and left > LATE * steps)


@allocation_free
def mark_best(best: Array, seen: Float32, at: int) -> None:
    """Mark the first move of the best plan with 1 and all others with 0."""
    top = 0
    for move in range(9):
        top = move if best[move] > best[top] else top
    for move in range(9):
        seen[at + move] = 1.0 if move == top else 0.0


@inlined
def put_monitor_plan(c: Constants, farm: Farm, s: Scratch, u: int, at: int) -> int:
    """Write the plans of a monitoring UAV; return where they end."""
    plans, plan, most, position = c.plans, s.plot_plan, c.camera.level_max, farm.position
    x, y = position[u, 0], position[u, 1]
    wide = plans.plot_reach + c.added.step_x * (plans.steps + 1)
    deep = plans.plot_reach + c.added.step_y * (plans.steps + 1)
    level = farm.level.reshape(-1)
    found = find_sites(u, x, y, wide, deep, farm.step, level, plans.plot_x, plans.plot_y, plan)
    sort_by_point(found, plans.plot_first, plans.plot_point, plans.plot_chance, plan)
    _look(c, farm, s, u, 0, found, most, plan)
    return put_plan(plans.steps, most, plan.best, farm.observation, at)


@inlined
def put_collector_plan(c: Constants, farm: Farm, s: Scratch, u: int, at: int) -> int:
    """Write the plans of a data collection UAV; return where they end."""
    plans, plan, most, position = c.plans, s.sensor_plan, c.radio.level_max, farm.position
    x, y = position[u, 0], position[u, 1]
    wide = plans.reach + c.added.step_x * (plans.steps + 1)
    deep = plans.reach + c.added.step_y * (plans.steps + 1)
    found = find_sites(u, x, y, wide, deep, farm.step, farm.age, farm.sensor[0], farm.sensor[1], plan)
    sort_by_point(found, farm.plan_first, farm.plan_point, farm.plan_chance, plan)
    _look(c, farm, s, u, 1, found, most, plan)
    return put_plan(plans.steps, most, plan.best, farm.observation, at)


@inlined
def _look(c: Constants, farm: Farm, s: Scratch, u: int, task: int, found: int, most: float, plan: PlanScratch) -> None:
    """Search the plans of a UAV up to the end of the episode; after that nothing is worth anything."""
    fleet, plans, position, sign = c.fleet, c.plans, farm.position, s.added.sign
    steps = min(plans.steps, fleet.steps - farm.step)
    column = own_point(position[u, 0], sign[u, 0], fleet.width, fleet.per_width, plans.columns)
    row = own_point(position[u, 1], sign[u, 1], fleet.depth, fleet.per_depth, plans.rows)
    turn_x, turn_y = int(sign[u, 0]), int(sign[u, 1])
    unit = c.reward.utility[task] * fleet.seconds
    step_costs(c.flight, plans, fleet.width, fleet.depth, fleet.seconds, c.reward.energy, unit, plan.costs)
    idle = -c.reward.idle[task] * fleet.seconds / unit if unit > 0.0 else 0.0
    search(plans.columns, plans.rows, steps, column, row, turn_x, turn_y, found, idle, np.float32(most), plan)


@allocation_free
def put_plan(steps: int, most: float, best: Array, seen: Float32, at: int) -> int:
    """Write how near each move's best plan comes to the best of all, and the worth of that; return where they end.

    A plan that is worth SHARE of a full item less than the best of all is marked with 1/e.

    Args:
        steps: H.
        most: largest level.
        best: [9] worths, in units.
        seen: row of observations.
        at: where to begin in it.
    """
    top = -math.inf
    for move in range(9):
        top = max(top, best[move])
    for move in range(9):
        seen[at + move] = math.exp((best[move] - top) / (SHARE * most))
    seen[at + 9] = min(1.0, max(-1.0, top / (most * steps)))
    return at + NUMBERS
