"""Communication UAVs: which UAVs each one serves, and its quality of service D_c."""

import math

from rollout.sim.kernel.arrays import AssignmentScratch, Farm, Scratch
from rollout.sim.kernel.assignment.exchanges import settle
from rollout.sim.kernel.assignment.hungarian import assign
from rollout.sim.kernel.compiler.decorators import allocation_free, inlined
from rollout.sim.kernel.compiler.logarithm import vectorisable_log
from rollout.sim.kernel.constants import LEAST_LINK, Array, Constants, FleetConstants, Indices, RelayConstants
from rollout.sim.kernel.motion import separation
from rollout.sim.kernel.planes import height_of


@inlined
def assign_relays(c: Constants, farm: Farm, s: Scratch, fresh: bool) -> None:
    """Assign every monitoring and data collection UAV to a relay (W2, W3).

    The cost of a pair is cost_distance d / diagonal + cost_link FSPL(d) / FSPL(diagonal). Every relay has
    `capacity` columns. The previous assignment is repaired by a few exchanges if that proves a unique optimum.

    Updates `assignment` and writes `quality`, the signal-to-noise ratio of each link, and `linked`, 1 where the relay
    is within link range (W4).

    Args:
        c: constants.
        farm: the environment.
        s: scratch.
        fresh: whether the episode begins, so that there is no previous assignment.
    """
    fleet, relay, position, work, assignment = c.fleet, c.relay, farm.position, s.assigning, farm.assignment
    linked, quality = s.linked, farm.quality
    _weigh_pairs(fleet, relay, s.x, s.y, work.pair)
    if fresh or not settle(work.pair, assignment, relay.capacity, work.exchanges):
        _assign_anew(fleet, relay, position, work, assignment)
    for served in range(len(assignment)):
        distance = separation(fleet, position, assignment[served], fleet.relays + served)
        linked[served] = 1.0 if distance <= relay.link_range else 0.0
        quality[served] = relay.budget - _loss(relay, distance)


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
def _assign_anew(
    fleet: FleetConstants, relay: RelayConstants, position: Array, work: AssignmentScratch, assignment: Indices
) -> None:
    """Assign from scratch, breaking ties as the reference does."""
    for served in range(len(assignment)):
        for i in range(fleet.relays):
            distance = separation(fleet, position, i, fleet.relays + served)
            cost = relay.cost_distance * distance + relay.cost_link * _loss(relay, distance)
            for place in range(relay.capacity):
                work.cost[served, i * relay.capacity + place] = cost
    assign(work.cost, work.numbers, work.indices, assignment)
    for served in range(len(assignment)):
        assignment[served] //= relay.capacity


@inlined
def measure_service(c: Constants, farm: Farm, s: Scratch) -> None:
    """Compute D_c = epsilon_1 D_cg + epsilon_2 D_cf + epsilon_3 D_cc of every relay, in three dimensions.

    Writes D_c to `service` after saving D_c(k-1) in `earlier`. A relay that serves no UAV has D_cg = D_cf = 0. Writes
    to the scratch `centroid`, whose last row is the centroid of all relays, and `farthest`, -1 for a relay that serves
    none.
    """
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
        centroid[count, 0] += position[i, 0] / count
        centroid[count, 1] += position[i, 1] / count
        centroid[count, 2] += height_of(fleet, i) / count
    for i in range(count):
        service[i] = relay.weight_farthest * max(far[i], 0.0)
        if farthest[i] >= 0:
            service[i] += relay.weight_centroid * _to_point(fleet, position, i, centroid[i])
        service[i] += relay.weight_relays * _to_point(fleet, position, i, centroid[count])


@allocation_free
def _to_point(fleet: FleetConstants, position: Array, u: int, point: Array) -> float:
    dx, dy, dz = point[0] - position[u, 0], point[1] - position[u, 1], point[2] - height_of(fleet, u)
    return math.sqrt(dx * dx + dy * dy + dz * dz)
