"""Communication UAVs: which UAVs each one serves, and its quality of service D_c."""

import math
from typing import Final

from eia_sec.rollout.sim.conditions.failures import NOBODY, capacity_left
from eia_sec.rollout.sim.conditions.links import join_relays
from eia_sec.rollout.sim.core.arrays import Farm, Scratch
from eia_sec.rollout.sim.core.assignment import AssignmentScratch, assign, settle
from eia_sec.rollout.sim.core.compile import allocation_free, inlined
from eia_sec.rollout.sim.core.constants import LEAST_LINK, Constants, FleetConstants, RelayConstants
from eia_sec.rollout.sim.core.logarithm import vectorisable_log
from eia_sec.rollout.sim.core.motion import separation
from eia_sec.rollout.sim.core.planes import height_of
from eia_sec.rollout.sim.core.records import Array, Flags, Indices

NO_LINK: Final = -1000.0
"""Quality of the link of a UAV that has no relay, dB; finite, because views carry only finite numbers (ours)."""


@inlined
def assign_relays(c: Constants, farm: Farm, s: Scratch, anew: bool) -> None:
    """Assign every living monitoring and data collection UAV to a living relay (W2, W3).

    The cost of a pair is cost_distance d / diagonal + cost_link FSPL(d) / FSPL(diagonal). Every relay has
    `capacity` columns. The previous assignment is repaired by a few exchanges if that proves a unique optimum.

    Updates `assignment` and writes `quality`, the signal-to-noise ratio of each link, and `linked`, 1 where the relay
    is within link range (W4) and, with a base station, joined to it. A UAV without a relay has the quality NO_LINK, and
    no range reaches it. Writes `joined` where there is a base station.

    Args:
        c: constants.
        farm: the environment.
        s: scratch.
        anew: whether there is no previous assignment, or UAVs have failed since.
    """
    fleet, relay, position, work, assignment = c.fleet, c.relay, farm.position, s.assigning, farm.assignment
    linked, quality = s.linked, farm.quality
    capacity, gone = relay.capacity, farm.gone
    _weigh_pairs(fleet, relay, s.x, s.y, work.pair)
    if c.fleet.mortal:
        capacity = capacity_left(capacity, farm.living)
        _leave_out(gone, work.pair)
    if anew or not settle(work.pair, assignment, capacity, work.exchanges):
        _assign_anew(fleet, relay, gone, capacity, position, work, assignment)
    if c.relay.chained:
        join_relays(c.relay, position, gone, NOBODY, math.inf, math.inf, s.joined, s.queue)
    for served in range(len(assignment)):
        u, distance, quality[served] = fleet.relays + served, math.inf, NO_LINK
        if assignment[served] != NOBODY:
            distance = separation(fleet, position, assignment[served], u)
            quality[served] = relay.budget - _loss(relay, distance)
        linked[served] = 1.0 if distance <= relay.link_range and not gone[u] else 0.0
        if c.relay.chained and assignment[served] != NOBODY and not s.joined[assignment[served]]:
            linked[served] = 0.0


@allocation_free
def _loss(relay: RelayConstants, distance: float) -> float:
    """Return the free-space loss between two UAVs, dB (W12)."""
    return relay.loss_scale * math.log(max(distance * distance, LEAST_LINK)) + relay.loss_offset


@allocation_free
def _weigh_pairs(fleet: FleetConstants, relay: RelayConstants, x: Array, y: Array, pair: Array) -> None:
    """Write the cost of each pair, up to a constant and within 1e-12, several pairs at once."""
    link = relay.cost_link * relay.loss_scale
    for served in range(len(pair)):
        u, costs = fleet.relays + served, pair[served]
        own_x, own_y, dz = x[u], y[u], height_of(fleet, u) - height_of(fleet, 0)
        for i in range(fleet.relays):
            dx, dy = x[i] - own_x, y[i] - own_y
            square = dx * dx + dy * dy + dz * dz
            costs[i] = relay.cost_distance * math.sqrt(square) + link * vectorisable_log(max(square, LEAST_LINK))


@allocation_free
def _leave_out(gone: Flags, pair: Array) -> None:
    """Make relays that are gone infinitely expensive."""
    for i in range(pair.shape[1]):
        if gone[i]:
            pair[:, i] = math.inf


@allocation_free
def _assign_anew(
    fleet: FleetConstants,
    relay: RelayConstants,
    gone: Flags,
    capacity: int,
    position: Array,
    work: AssignmentScratch,
    assignment: Indices,
) -> None:
    """Assign the living from scratch, breaking ties as the reference does."""
    rows, columns = 0, 0
    for u in range(fleet.relays, fleet.uavs):
        if gone[u]:
            continue
        columns = 0
        for i in range(fleet.relays):
            if gone[i]:
                continue
            distance = separation(fleet, position, i, u)
            cost = relay.cost_distance * distance + relay.cost_link * _loss(relay, distance)
            for _ in range(capacity):
                work.cost[rows, columns] = cost
                columns += 1
        rows += 1
    if columns > 0:
        assign(work.cost, rows, columns, work.numbers, work.indices, assignment)
    # The first `rows` entries hold the columns of the living. From the last on, each moves to its UAV's own entry.
    for served in range(len(assignment) - 1, -1, -1):
        relay_of = NOBODY
        if not gone[fleet.relays + served]:
            rows -= 1
            relay_of = _living_relay(gone, assignment[rows] // capacity) if columns > 0 else NOBODY
        assignment[served] = relay_of


@allocation_free
def _living_relay(gone: Flags, number: int) -> int:
    """Return the relay with a number among the living, from 0."""
    i = 0
    while gone[i] or number > 0:
        number -= 0 if gone[i] else 1
        i += 1
    return i


@inlined
def measure_service(c: Constants, farm: Farm, s: Scratch) -> None:
    """Compute D_c = epsilon_1 D_cg + epsilon_2 D_cf + epsilon_3 D_cc of every relay, in three dimensions.

    Writes D_c to `service` after saving D_c(k-1) in `earlier`. A relay that serves no UAV has D_cg = D_cf = 0. Writes
    to the scratch `centroid`, whose last row is the centroid of all relays, and `farthest`, -1 for a relay that serves
    none. UAVs that are gone do not count; D_c of a relay that is gone is 0.
    """
    gone, living = farm.gone, farm.living[0]
    fleet, relay, position, assignment, service = c.fleet, c.relay, farm.position, farm.assignment, farm.service
    centroid, farthest, number, far = s.centroid, s.farthest, s.number, s.far
    for i in range(fleet.relays):
        s.earlier[i] = service[i]
    count = fleet.relays
    centroid[:, :] = 0.0
    for i in range(count):
        farthest[i], number[i], far[i] = -1, 0.0, -1.0
    for served in range(len(assignment)):
        i, u = assignment[served], count + served
        if i == NOBODY:
            continue
        centroid[i, 0], centroid[i, 1] = centroid[i, 0] + position[u, 0], centroid[i, 1] + position[u, 1]
        centroid[i, 2], number[i] = centroid[i, 2] + height_of(fleet, u), number[i] + 1.0
        distance = separation(fleet, position, i, u)
        if distance > far[i]:
            far[i], farthest[i] = distance, u
    for i in range(count):
        share = 1.0 / max(number[i], 1.0)
        centroid[i, 0], centroid[i, 1], centroid[i, 2] = (
            centroid[i, 0] * share,
            centroid[i, 1] * share,
            centroid[i, 2] * share,
        )
        if not gone[i]:
            centroid[count, 0] += position[i, 0] / living
            centroid[count, 1] += position[i, 1] / living
            centroid[count, 2] += height_of(fleet, i) / living
    for i in range(count):
        if gone[i]:
            service[i] = 0.0
            continue
        service[i] = relay.weight_farthest * max(far[i], 0.0)
        if farthest[i] >= 0:
            service[i] += relay.weight_centroid * _to_point(fleet, position, i, centroid[i])
        service[i] += relay.weight_relays * _to_point(fleet, position, i, centroid[count])


@allocation_free
def _to_point(fleet: FleetConstants, position: Array, u: int, point: Array) -> float:
    dx, dy, dz = point[0] - position[u, 0], point[1] - position[u, 1], point[2] - height_of(fleet, u)
    return math.sqrt(dx * dx + dy * dy + dz * dz)
