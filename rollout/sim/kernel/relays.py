"""Communication UAVs: whom each serves, and how well it stands."""

import math

from rollout.sim.kernel.arrays import Assigning
from rollout.sim.kernel.assignment.exchanges import settle
from rollout.sim.kernel.assignment.hungarian import assign
from rollout.sim.kernel.compiler.decorators import sealed
from rollout.sim.kernel.compiler.logarithm import logarithm
from rollout.sim.kernel.constants import LEAST_LINK, Array, FleetConstants, Indices, RelayConstants
from rollout.sim.kernel.motion import separation
from rollout.sim.kernel.planes import height_of


@sealed
def assign_relays(
    fleet: FleetConstants,
    relay: RelayConstants,
    position: Array,
    x: Array,
    y: Array,
    fresh: bool,
    work: Assigning,
    assignment: Indices,
    linked: Array,
    quality: Array,
) -> None:
    """Assign every monitoring and data collection UAV to a relay (W2, W3).

    The cost of a pair is cost_distance d / diagonal + cost_link FSPL(d) / FSPL(diagonal); every relay stands in
    `capacity` columns. Where a few swaps make the assignment of the step before the only best one, that is it.

    Args:
        fleet: the UAVs.
        relay: weights and capacity.
        position: [n, 2] m.
        x: [n] the same along each axis, m.
        y: [n] m.
        fresh: whether there is no step before.
        work: scratch.
        assignment: [n_m + n_d] relay of each served UAV; updated.
        linked: [n_m + n_d] out: 1 where the relay is within link range (W4).
        quality: [n_m + n_d] out: signal-to-noise ratio of the link to the relay, dB.
    """
    _weigh_pairs(fleet, relay, x, y, work.pair)
    if fresh or not settle(work.pair, assignment, relay.capacity, work.exchanges):
        _assign_anew(fleet, relay, position, work, assignment)
    for served in range(len(assignment)):
        distance = separation(fleet, position, assignment[served], fleet.relays + served)
        linked[served] = 1.0 if distance <= relay.link_range else 0.0
        quality[served] = relay.budget - _loss(relay, distance)


@sealed
def _loss(relay: RelayConstants, distance: float) -> float:
    """Return the free-space loss between two UAVs, dB (W12)."""
    return relay.loss_scale * math.log(max(distance * distance, LEAST_LINK)) + relay.loss_offset


@sealed
def _weigh_pairs(fleet: FleetConstants, relay: RelayConstants, x: Array, y: Array, pair: Array) -> None:
    """Write the cost of each pair, up to a constant and to 1e-12, several pairs at once."""
    link = relay.cost_link * relay.loss_scale
    for served in range(len(pair)):
        u, costs = fleet.relays + served, pair[served]
        own_x, own_y, dz = x[u], y[u], height_of(fleet, u) - height_of(fleet, 0)
        for i in range(fleet.relays):
            dx, dy = x[i] - own_x, y[i] - own_y
            square = dx * dx + dy * dy + dz * dz
            costs[i] = relay.cost_distance * math.sqrt(square) + link * logarithm(max(square, LEAST_LINK))


@sealed
def _assign_anew(
    fleet: FleetConstants, relay: RelayConstants, position: Array, work: Assigning, assignment: Indices
) -> None:
    """Assign from scratch, so that ties fall as in the reference."""
    for served in range(len(assignment)):
        for i in range(fleet.relays):
            distance = separation(fleet, position, i, fleet.relays + served)
            cost = relay.cost_distance * distance + relay.cost_link * _loss(relay, distance)
            for place in range(relay.capacity):
                work.cost[served, i * relay.capacity + place] = cost
    assign(work.cost, work.numbers, work.indices, assignment)
    for served in range(len(assignment)):
        assignment[served] //= relay.capacity


@sealed
def serve(
    fleet: FleetConstants,
    relay: RelayConstants,
    position: Array,
    assignment: Indices,
    service: Array,
    centroid: Array,
    farthest: Indices,
    number: Array,
    far: Array,
) -> None:
    """Compute D_c = epsilon_1 D_cg + epsilon_2 D_cf + epsilon_3 D_cc of every relay, in three dimensions.

    Args:
        fleet: the UAVs.
        relay: epsilon_1 to epsilon_3.
        position: [n, 2] m.
        assignment: [n_m + n_d] relay of each served UAV.
        service: [n_c] out: D_c, m; D_cg = D_cf = 0 for a relay that serves nobody.
        centroid: [n_c + 1, 3] out: centroid of those served by each relay, and in the last row that of all relays.
        farthest: [n_c] out: index of the farthest UAV served, -1 if none.
        number: [n_c] scratch: how many are served.
        far: [n_c] scratch: how far the farthest is, m.
    """
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


@sealed
def _to_point(fleet: FleetConstants, position: Array, u: int, point: Array) -> float:
    dx, dy, dz = point[0] - position[u, 0], point[1] - position[u, 1], point[2] - height_of(fleet, u)
    return math.sqrt(dx * dx + dy * dy + dz * dz)
