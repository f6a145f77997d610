"""Plans as monitors and data collection UAVs see them."""

import math
from typing import Final

import numpy as np

from eia_sec.common.farm_observation import PLAN_LOSS
from eia_sec.rollout.sim.core.arrays import Farm, Scratch
from eia_sec.rollout.sim.core.compile import allocation_free, inlined
from eia_sec.rollout.sim.core.constants import Constants, FleetConstants, FlightConstants
from eia_sec.rollout.sim.core.motion import flight_power
from eia_sec.rollout.sim.core.records import Array, Float32
from eia_sec.rollout.sim.observation.places import own_point
from eia_sec.rollout.sim.observation.plans.arrays import PlanScratch
from eia_sec.rollout.sim.observation.plans.coming import (
    find_owners,
    find_sites,
    know_plots,
    know_sensors,
    sort_by_point,
)
from eia_sec.rollout.sim.observation.plans.constants import PlanConstants
from eia_sec.rollout.sim.observation.plans.links import find_linked
from eia_sec.rollout.sim.observation.plans.search import search
from eia_sec.rollout.sim.observation.routes import STAY

NUMBERS: Final = 10
"""Numbers that say what plans are worth."""
LATE: Final = 3
"""Monitors who sweep along routes see plans and follow them in so many times the plans' steps at the end (ours)."""


@inlined
def prepare_plans(c: Constants, farm: Farm, s: Scratch) -> None:
    """Find what the plans of several UAVs need."""
    fleet, plans, weight, plots, sensors = c.fleet, c.plans, c.reward, s.plot_plan, s.sensor_plan
    if sees_plans(c.seen.route, plans.steps, fleet.steps - farm.time[0]):
        know_plots(c, farm, plots)
        find_owners(farm.position, fleet.relays, fleet.collectors, plans.plot_x, plans.plot_y, plots)
        step_costs(c.flight, fleet, plans, weight.energy, weight.utility[0], weight.idle[0], plots.costs)
        find_linked(c, farm, s, fleet.relays, plots)
    know_sensors(c, farm, sensors)
    find_owners(farm.position, fleet.collectors, fleet.uavs, farm.sensor[0], farm.sensor[1], sensors)
    step_costs(c.flight, fleet, plans, weight.energy, weight.utility[1], weight.idle[1], sensors.costs)
    find_linked(c, farm, s, fleet.collectors, sensors)


@allocation_free
def step_costs(
    flight: FlightConstants,
    fleet: FleetConstants,
    plans: PlanConstants,
    energy: float,
    utility: float,
    idle: float,
    costs: Array,
) -> None:
    """Write what steps cost, in units; if a unit is worth nothing, nothing costs anything.

    Args:
        flight: flight power.
        fleet: the field.
        plans: the lattice.
        energy: weight of the energy in the reward, 1/J; not above 0.
        utility: weight of a unit.
        idle: weight of P_M or P_C; not above 0.
        costs: [5] out: the energy of staying, of a step along y, one along x and one along both; and P_M or P_C.
    """
    across, along = fleet.width / (plans.columns * fleet.seconds), fleet.depth / (plans.rows * fleet.seconds)
    unit = utility * fleet.seconds
    per_joule = -energy * fleet.seconds / unit if unit > 0.0 else 0.0
    costs[0], costs[1] = per_joule * flight_power(flight, 0.0), per_joule * flight_power(flight, along)
    costs[2] = per_joule * flight_power(flight, across)
    costs[3] = per_joule * flight_power(flight, math.sqrt(across * across + along * along))
    costs[4] = -idle * fleet.seconds / unit if unit > 0.0 else 0.0


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
    """Mark the first move of the best plan with 1 and all others with 0; if no move is possible, that of staying."""
    top = 0
    for move in range(9):
        top = move if best[move] > best[top] else top
    if best[top] == -math.inf:
        top = STAY
    for move in range(9):
        seen[at + move] = 1.0 if move == top else 0.0


@inlined
def put_monitor_plan(c: Constants, farm: Farm, s: Scratch, u: int, at: int) -> int:
    """Write the plans of a monitoring UAV; return where they end."""
    plans, plan, level = c.plans, s.plot_plan, farm.level.reshape(-1)
    sites = _find(c, farm, u, plans.plot_reach, level, plans.plot_x, plans.plot_y, plan)
    sort_by_point(sites, plans.plot_first, plans.plot_point, plans.plot_chance, plan)
    return _put_best(c, farm, s, u, sites, c.camera.level_max, plan, at)


@inlined
def put_collector_plan(c: Constants, farm: Farm, s: Scratch, u: int, at: int) -> int:
    """Write the plans of a data collection UAV; return where they end."""
    plan, sensor = s.sensor_plan, farm.sensor
    sites = _find(c, farm, u, c.plans.reach, farm.age, sensor[0], sensor[1], plan)
    sort_by_point(sites, farm.plan_first, farm.plan_point, farm.plan_chance, plan)
    return _put_best(c, farm, s, u, sites, c.radio.level_max, plan, at)


@inlined
def _find(
    c: Constants, farm: Farm, u: int, reach: float, level: Array, site_x: Array, site_y: Array, plan: PlanScratch
) -> int:
    """List the sites that a UAV can reach within its plans; return how many."""
    view, position, moves = c.added, farm.position, c.plans.steps + 1
    wide, deep = reach + view.step_x * moves, reach + view.step_y * moves
    return find_sites(u, position[u, 0], position[u, 1], wide, deep, farm.time[0], level, site_x, site_y, plan)


@inlined
def _put_best(c: Constants, farm: Farm, s: Scratch, u: int, sites: int, most: float, plan: PlanScratch, at: int) -> int:
    """Search up to the end of the episode, after which nothing is worth anything, and write what was found."""
    fleet, plans, position, sign = c.fleet, c.plans, farm.position, s.added.sign
    steps = min(plans.steps, fleet.steps - farm.time[0])
    column = own_point(position[u, 0], sign[u, 0], fleet.width, fleet.per_width, plans.columns)
    row = own_point(position[u, 1], sign[u, 1], fleet.depth, fleet.per_depth, plans.rows)
    turn_x, turn_y = int(sign[u, 0]), int(sign[u, 1])
    search(
        plans.columns,
        plans.rows,
        steps,
        column,
        row,
        turn_x,
        turn_y,
        s.added.stopped,
        farm.barred,
        sites,
        np.float32(most),
        plan,
    )
    return put_plan(plans.steps, most, plan.best, farm.observation, at)


@allocation_free
def put_plan(steps: int, most: float, best: Array, seen: Float32, at: int) -> int:
    """Write how near each move's best plan comes to the best of all, and the worth of that; return where they end.

    A plan that is worth PLAN_LOSS of a full item less than the best of all is marked with 1/e, one that cannot be flown
    with 0.

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
        seen[at + move] = math.exp((best[move] - top) / (PLAN_LOSS * most)) if best[move] > -math.inf else 0.0
    seen[at + 9] = min(1.0, max(-1.0, top / (most * steps)))
    return at + NUMBERS
