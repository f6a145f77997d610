"""The added observations of each type, in the order of their switches."""

import numpy as np
from numpy.typing import NDArray

from eia_sec.rollout.sim.kernel.arrays import Farm, Scratch
from eia_sec.rollout.sim.kernel.compiler.decorators import allocation_free, inlined
from eia_sec.rollout.sim.kernel.constants import Constants
from eia_sec.rollout.sim.kernel.flight.battery import put_charge
from eia_sec.rollout.sim.kernel.flight.failures import see_nothing
from eia_sec.rollout.sim.kernel.plans.view import (
    NUMBERS,
    mark_best,
    prepare_plans,
    put_collector_plan,
    put_monitor_plan,
    sees_plans,
)
from eia_sec.rollout.sim.kernel.spatial.neighbours import cell_of
from eia_sec.rollout.sim.kernel.stress import put_stress
from eia_sec.rollout.sim.kernel.views.airspace import find_stopped, put_airspace
from eia_sec.rollout.sim.kernel.views.constants import ViewConstants
from eia_sec.rollout.sim.kernel.views.fields import put_field, share_points, weigh_points
from eia_sec.rollout.sim.kernel.views.links import put_chain, put_joined, put_link, put_links
from eia_sec.rollout.sim.kernel.views.maps import put_cells, put_plots
from eia_sec.rollout.sim.kernel.views.peers import find_near, put_peers, put_risk
from eia_sec.rollout.sim.kernel.views.places import find_places
from eia_sec.rollout.sim.kernel.views.routes import NUMBERS as ROUTE_NUMBERS
from eia_sec.rollout.sim.kernel.views.routes import put_route
from eia_sec.rollout.sim.kernel.views.service import put_service
from eia_sec.rollout.sim.kernel.views.units import plan_images, plan_packets, put_units

Float32 = NDArray[np.float32]

SOON, LATER = 25.0, 100.0
"""Steps before the end at which the two counts of the steps left begin to fall (ours)."""


@inlined
def prepare_views(c: Constants, farm: Farm, s: Scratch) -> None:
    """Find what several UAVs' added observations need."""
    fleet, view, plots, cells = c.fleet, c.added, s.added.plots, s.added.cells
    find_places(c, farm, s)
    if view.fields:
        first, second = fleet.relays, fleet.collectors
        weigh_points(farm.level_above, 1.0 / c.camera.level_max, plots)
        share_points(s.x[first:second], s.y[first:second], plots)
        weigh_points(farm.age_above, 1.0 / c.radio.level_max, cells)
        share_points(s.x[second : fleet.uavs], s.y[second : fleet.uavs], cells)
    if c.plans.steps > 0:
        prepare_plans(c, farm, s)


@inlined
def _put_others(c: Constants, s: Scratch, u: int, first: int, last: int, tasks: bool, seen: Float32, at: int) -> int:
    """Write `peers`, `last_move` and, for UAVs with tasks, `closing`; return where they end."""
    fleet, view, v = c.fleet, c.added, s.added
    sx, sy, found = v.sign[u, 0], v.sign[u, 1], 0
    closing = view.closing and tasks
    if view.peers > 0 or closing:
        wanted = max(view.peers, 2)
        found = find_near(s.x, s.y, u, first, last, wanted, v.near, v.near_square)
    at = put_peers(fleet, s.x, s.y, v.velocity, u, sx, sy, found, view.peers, v.near, seen, at)
    if view.last_move:
        seen[at], seen[at + 1] = sx * v.velocity[u, 0], sy * v.velocity[u, 1]
        at += 2
    if closing:
        at = put_risk(
            fleet,
            view.danger_square,
            view.step_x,
            view.step_y,
            s.x,
            s.y,
            v.velocity,
            v.go_x,
            v.go_y,
            u,
            found,
            v.near,
            v.near_square,
            v.risk,
            seen,
            at,
        )
    return at


@allocation_free
def _put_left(left: int, seen: Float32, at: int) -> int:
    """Write the two counts of the steps left; return where they end."""
    seen[at], seen[at + 1] = min(1.0, left / SOON), min(1.0, left / LATER)
    return at + 2


@allocation_free
def _put_alive(living: int, count: int, seen: Float32, at: int) -> int:
    """Write the share of a type's UAVs that have not failed; return where it ends."""
    seen[at] = living / count
    return at + 1


@allocation_free
def _put_events(c: Constants, farm: Farm, s: Scratch, u: int, at: int) -> int:
    """Write charge, wind and zones; return where they end. It is compiled once for all types."""
    view, v = c.added, s.added
    if view.charge:
        at = put_charge(c, farm, u, v.sign[u, 0], v.sign[u, 1], at)
    if view.wind or view.zones:
        at = put_airspace(c, farm, v.stopped, v.sign[u, 0], v.sign[u, 1], farm.observation, at)
    return at


@inlined
def _put_last(c: Constants, farm: Farm, s: Scratch, u: int, kind: int, count: int, at: int) -> int:
    """Write what every type sees last: charge, wind and zones, who is alive, and room for advice; return the end."""
    view, seen = c.added, farm.observation
    if view.charge or view.wind or view.zones:
        at = _put_events(c, farm, s, u, at)
    if view.alive:
        at = _put_alive(farm.living[kind], count, seen, at)
    return see_nothing(view.advice[kind], seen, at)


@inlined
def add_relay(c: Constants, farm: Farm, s: Scratch, u: int, at: int) -> int:
    """Write the added observations of a relay; return where they end."""
    fleet, view, v, seen = c.fleet, c.added, s.added, farm.observation
    find_stopped(c, farm, s, u)
    at = _put_others(c, s, u, 0, fleet.relays, False, seen, at)
    if view.phases:
        at = _put_left(fleet.steps - farm.step, seen, at)
    if view.service:
        at = put_service(
            fleet,
            c.relay,
            view.per_step,
            farm.position,
            farm.assignment,
            farm.living[0],
            s.centroid,
            farm.service[u],
            u,
            v.go_x[u],
            v.go_y[u],
            seen,
            at,
        )
    if view.link:
        sx, sy = v.sign[u, 0], v.sign[u, 1]
        at = put_links(fleet, view, farm.position, farm.assignment, u, sx, sy, v.go_x[u], v.go_y[u], seen, at)
        if c.chain.some:
            at = put_chain(c, farm, s, u, at)
    return _put_last(c, farm, s, u, 0, fleet.relays, at)


@inlined
def add_monitor(c: Constants, farm: Farm, s: Scratch, u: int, column: int, row: int, at: int) -> int:
    """Write the added observations of a monitoring UAV over a plot; return where they end."""
    fleet, camera, view, v, seen, position = c.fleet, c.camera, c.added, s.added, farm.observation, farm.position
    sx, sy = v.sign[u, 0], v.sign[u, 1]
    find_stopped(c, farm, s, u)
    at = _put_others(c, s, u, fleet.relays, fleet.collectors, True, seen, at)
    if view.units > 0:
        plan_images(fleet, camera, view, v, position, farm.level, u)
        at = put_units(view, v, 1.0 / camera.level_max, seen, at)
    planned = sees_plans(view.route, c.plans.steps, fleet.steps - farm.step)
    if c.plans.steps > 0:
        at = put_monitor_plan(c, farm, s, u, at) if planned else see_nothing(NUMBERS, seen, at)
    if view.fields:
        x, y = position[u, 0], position[u, 1]
        per_reach = 1.0 / (view.step_x + view.step_y)
        at = put_field(
            fleet,
            x,
            y,
            v.go_x[u],
            v.go_y[u],
            view.plots_x,
            view.plots_y,
            view.range,
            per_reach,
            v.plots,
            seen,
            at,
        )
    if view.coarse:
        at = put_plots(farm.level, farm.level_above, column, row, sx, sy, camera.level_max, seen, at)
    if view.phases:
        seen[at] = farm.step % camera.cycle / camera.cycle
        at = _put_left(fleet.steps - farm.step, seen, at + 1)
    if view.route:
        at = put_route(c, farm, s, u, at)
        if planned:
            mark_best(s.plot_plan.best, seen, at - ROUTE_NUMBERS)
    if view.link:
        relay = farm.assignment[u - fleet.relays]
        at = put_link(fleet, view, position, relay, u, sx, sy, v.go_x[u], v.go_y[u], seen, at)
        if c.chain.some:
            at = put_joined(relay, s.joined, seen, at)
    if view.stress:
        at = put_stress(farm.stressed, column, row, sx, sy, seen, at)
    return _put_last(c, farm, s, u, 1, fleet.collectors - fleet.relays, at)


@allocation_free
def _put_phases(view: ViewConstants, step: int, seen: Float32, at: int) -> int:
    """Write the elapsed share of the running cycle of each sensor type; return where they end."""
    for kind in range(len(view.age_cycles)):
        cycle = view.age_cycles[kind]
        seen[at + kind] = step % cycle / cycle
    return at + len(view.age_cycles)


@inlined
def add_collector(c: Constants, farm: Farm, s: Scratch, u: int, at: int) -> int:
    """Write the added observations of a data collection UAV; return where they end."""
    fleet, what, view, v, seen, position = c.fleet, c.observation, c.added, s.added, farm.observation, farm.position
    x, y, sx, sy = position[u, 0], position[u, 1], v.sign[u, 0], v.sign[u, 1]
    find_stopped(c, farm, s, u)
    at = _put_others(c, s, u, fleet.collectors, fleet.uavs, True, seen, at)
    if view.units > 0:
        plan_packets(fleet, what, view, v, position, farm.sensor, farm.cell_start, farm.age, s.around, s.square, u)
        at = put_units(view, v, 0.5 / c.radio.level_max, seen, at)
    if c.plans.steps > 0:
        at = put_collector_plan(c, farm, s, u, at)
    if view.fields:
        per_reach = 1.0 / (view.step_x + view.step_y)
        at = put_field(
            fleet,
            x,
            y,
            v.go_x[u],
            v.go_y[u],
            view.cells_x,
            view.cells_y,
            view.range,
            per_reach,
            v.cells,
            seen,
            at,
        )
    if view.coarse:
        column, row = cell_of(x / fleet.width, what.cells_x), cell_of(y / fleet.depth, what.cells_y)
        at = put_cells(farm.age_above, column, row, sx, sy, c.radio.level_max, seen, at)
    if view.phases:
        at = _put_phases(view, farm.step, seen, at)
        at = _put_left(fleet.steps - farm.step, seen, at)
    if view.link:
        relay = farm.assignment[u - fleet.relays]
        at = put_link(fleet, view, position, relay, u, sx, sy, v.go_x[u], v.go_y[u], seen, at)
        if c.chain.some:
            at = put_joined(relay, s.joined, seen, at)
    if view.stress:
        column, row = cell_of(x / fleet.width, c.camera.plots_x), cell_of(y / fleet.depth, c.camera.plots_y)
        at = put_stress(farm.stressed, column, row, sx, sy, seen, at)
    return _put_last(c, farm, s, u, 2, fleet.uavs - fleet.collectors, at)
