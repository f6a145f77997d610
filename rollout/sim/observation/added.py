"""The added observations of each type, in the order of their switches."""

from eia_sec.common.farm_observation import LATER, SOON
from eia_sec.rollout.sim.conditions.battery import put_charge
from eia_sec.rollout.sim.conditions.failures import put_alive, see_nothing
from eia_sec.rollout.sim.conditions.links import put_chain, put_joined, put_link, put_links
from eia_sec.rollout.sim.conditions.stress import put_stress
from eia_sec.rollout.sim.conditions.wind import put_wind
from eia_sec.rollout.sim.conditions.zones import find_stopped, put_zones
from eia_sec.rollout.sim.core.arrays import Farm, Scratch
from eia_sec.rollout.sim.core.cells import cell_of
from eia_sec.rollout.sim.core.compile import allocation_free, inlined
from eia_sec.rollout.sim.core.constants import Constants
from eia_sec.rollout.sim.core.records import Float32
from eia_sec.rollout.sim.observation.constants import ViewConstants
from eia_sec.rollout.sim.observation.fields import put_field, share_points, weigh_points
from eia_sec.rollout.sim.observation.inertia import put_motion
from eia_sec.rollout.sim.observation.maps import put_cells, put_plots
from eia_sec.rollout.sim.observation.peers import find_near, put_peers, put_risk
from eia_sec.rollout.sim.observation.places import find_places
from eia_sec.rollout.sim.observation.plans.view import (
    NUMBERS,
    mark_best,
    prepare_plans,
    put_collector_plan,
    put_monitor_plan,
    sees_plans,
)
from eia_sec.rollout.sim.observation.routes import NUMBERS as ROUTE_NUMBERS
from eia_sec.rollout.sim.observation.routes import put_route
from eia_sec.rollout.sim.observation.service import put_service
from eia_sec.rollout.sim.observation.units import plan_images, plan_packets, put_units


@inlined
def prepare_views(c: Constants, farm: Farm, s: Scratch) -> None:
    """Find what several UAVs' added observations need."""
    fleet, plots, cells = c.fleet, s.added.plots, s.added.cells
    find_places(c, farm, s)
    if c.seen.fields:
        first, second = fleet.relays, fleet.collectors
        weigh_points(farm.level_above, 1.0 / c.camera.level_max, plots)
        share_points(s.x[first:second], s.y[first:second], plots)
        weigh_points(farm.age_above, 1.0 / c.radio.level_max, cells)
        share_points(s.x[second : fleet.uavs], s.y[second : fleet.uavs], cells)
    if c.plans.steps > 0:
        prepare_plans(c, farm, s)


@inlined
def _put_others(c: Constants, farm: Farm, s: Scratch, u: int, kind: int, first: int, last: int, at: int) -> int:
    """Write `peers`, `last_move`, the motion and, for UAVs with tasks, `closing`; return where they end."""
    fleet, view, v, seen, tasks = c.fleet, c.added, s.added, farm.observation, kind > 0
    sx, sy, found = v.sign[u, 0], v.sign[u, 1], 0
    closing = c.seen.closing and tasks
    if c.seen.peers > 0 or closing:
        wanted = max(c.seen.peers, 2)
        found = find_near(s.x, s.y, u, first, last, wanted, v.near, v.near_square)
    at = put_peers(fleet, s.x, s.y, v.velocity, u, sx, sy, found, c.seen.peers, v.near, seen, at)
    if c.seen.last_move:
        seen[at], seen[at + 1] = sx * v.velocity[u, 0], sy * v.velocity[u, 1]
        at += 2
    if c.dynamics.some:
        at = put_motion(
            fleet,
            c.dynamics,
            kind,
            view.stop_scale[kind],
            farm.motion[u],
            s.x[u],
            s.y[u],
            sx,
            sy,
            v.stop_x[u],
            v.stop_y[u],
            farm.zone_side,
            farm.zone_box,
            seen,
            at,
        )
    if closing:
        at = put_risk(
            fleet,
            view.per_hold,
            view.danger_square,
            view.step_x,
            view.step_y,
            s.x,
            s.y,
            v.velocity,
            v.go_x,
            v.go_y,
            v.path_x,
            v.path_y,
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
def _put_events(c: Constants, farm: Farm, s: Scratch, u: int, at: int) -> int:
    """Write charge, wind and zones; return where they end. It is compiled once for all types."""
    v = s.added
    if c.seen.charge:
        at = put_charge(c, farm, u, v.sign[u, 0], v.sign[u, 1], at)
    if c.seen.wind:
        at = put_wind(c.fleet, farm.wind, farm.time[0], v.sign[u, 0], v.sign[u, 1], farm.observation, at)
    if c.seen.zones:
        at = put_zones(v.stopped, farm.observation, at)
    return at


@inlined
def _put_last(c: Constants, farm: Farm, s: Scratch, u: int, kind: int, count: int, at: int) -> int:
    """Write what every type sees last: charge, wind and zones, and who is alive; return the end."""
    view, seen = c.added, farm.observation
    if c.seen.charge or c.seen.wind or c.seen.zones:
        at = _put_events(c, farm, s, u, at)
    if view.alive:
        at = put_alive(farm.living[kind], count, seen, at)
    return at


@inlined
def _find_stopped(c: Constants, farm: Farm, s: Scratch, u: int) -> None:
    """Find which moves of a UAV a zone would refuse, where something is to see of it; without zones none is."""
    if c.fleet.zones and (c.seen.zones or c.ways.some):
        x, y, go_x, go_y = farm.position[u, 0], farm.position[u, 1], s.added.go_x[u], s.added.go_y[u]
        find_stopped(c.fleet.zone_first, farm.zone_side, farm.zone_box, x, y, go_x, go_y, s.added.stopped)


@inlined
def add_relay(c: Constants, farm: Farm, s: Scratch, u: int, at: int) -> int:
    """Write the added observations of a relay; return where they end."""
    fleet, view, v, seen = c.fleet, c.added, s.added, farm.observation
    _find_stopped(c, farm, s, u)
    at = _put_others(c, farm, s, u, 0, 0, fleet.relays, at)
    if c.seen.phases:
        at = _put_left(fleet.steps - farm.time[0], seen, at)
    if c.seen.service:
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
    if c.seen.link:
        sx, sy = v.sign[u, 0], v.sign[u, 1]
        at = put_links(fleet, view, farm.position, farm.assignment, u, sx, sy, v.go_x[u], v.go_y[u], seen, at)
        if c.relay.chained:
            at = put_chain(c, farm, s, u, at)
    return _put_last(c, farm, s, u, 0, fleet.relays, at)


@inlined
def add_monitor(c: Constants, farm: Farm, s: Scratch, u: int, column: int, row: int, at: int) -> int:
    """Write the added observations of a monitoring UAV over a plot; return where they end."""
    fleet, camera, view, v, seen, position = c.fleet, c.camera, c.added, s.added, farm.observation, farm.position
    sx, sy = v.sign[u, 0], v.sign[u, 1]
    _find_stopped(c, farm, s, u)
    at = _put_others(c, farm, s, u, 1, fleet.relays, fleet.collectors, at)
    if c.seen.units > 0:
        plan_images(fleet, camera, view, c.dynamics.some, c.seen.units > 1, v, position, farm.level, u)
        at = put_units(c.dynamics.some, c.seen.units > 1, view.first, v, 1.0 / camera.level_max, seen, at)
    planned = sees_plans(c.seen.route, c.plans.steps, fleet.steps - farm.time[0])
    if c.plans.steps > 0:
        at = put_monitor_plan(c, farm, s, u, at) if planned else see_nothing(NUMBERS, seen, at)
    if c.seen.fields:
        x, y = position[u, 0], position[u, 1]
        per_reach = view.per_hold / (view.step_x + view.step_y)
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
    if c.seen.coarse:
        at = put_plots(farm.level, farm.level_above, column, row, sx, sy, camera.level_max, seen, at)
    if c.seen.phases:
        seen[at] = farm.time[0] % camera.cycle / camera.cycle
        at = _put_left(fleet.steps - farm.time[0], seen, at + 1)
    if c.seen.route:
        at = put_route(c, farm, s, u, at)
        if planned:
            mark_best(s.plot_plan.best, seen, at - ROUTE_NUMBERS)
    if c.seen.link:
        relay = farm.assignment[u - fleet.relays]
        at = put_link(fleet, view, position, relay, u, sx, sy, v.go_x[u], v.go_y[u], seen, at)
        if c.relay.chained:
            at = put_joined(relay, s.joined, seen, at)
    if c.seen.stress:
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
    _find_stopped(c, farm, s, u)
    at = _put_others(c, farm, s, u, 2, fleet.collectors, fleet.uavs, at)
    if c.seen.units > 0:
        plan_packets(
            fleet,
            what,
            view,
            c.dynamics.some,
            c.seen.units > 1,
            v,
            position,
            farm.sensor,
            farm.cell_start,
            farm.age,
            s.around,
            s.square,
            u,
        )
        at = put_units(c.dynamics.some, c.seen.units > 1, view.first, v, 0.5 / c.radio.level_max, seen, at)
    if c.plans.steps > 0:
        at = put_collector_plan(c, farm, s, u, at)
    if c.seen.fields:
        per_reach = view.per_hold / (view.step_x + view.step_y)
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
    if c.seen.coarse:
        column, row = cell_of(x / fleet.width, what.cells_x), cell_of(y / fleet.depth, what.cells_y)
        at = put_cells(farm.age_above, column, row, sx, sy, c.radio.level_max, seen, at)
    if c.seen.phases:
        at = _put_phases(view, farm.time[0], seen, at)
        at = _put_left(fleet.steps - farm.time[0], seen, at)
    if c.seen.link:
        relay = farm.assignment[u - fleet.relays]
        at = put_link(fleet, view, position, relay, u, sx, sy, v.go_x[u], v.go_y[u], seen, at)
        if c.relay.chained:
            at = put_joined(relay, s.joined, seen, at)
    if c.seen.stress:
        column, row = cell_of(x / fleet.width, c.camera.plots_x), cell_of(y / fleet.depth, c.camera.plots_y)
        at = put_stress(farm.stressed, column, row, sx, sy, seen, at)
    return _put_last(c, farm, s, u, 2, fleet.uavs - fleet.collectors, at)
