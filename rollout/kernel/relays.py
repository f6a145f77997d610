"""Communication UAVs: whom each serves, and how well it stands."""

import math

from rollout.kernel.arrays import Assigning
from rollout.kernel.assignment import assign, settle
from rollout.kernel.compiled import sealed
from rollout.kernel.constants import LEAST_LINK, Array, FleetConstants, Indices, RelayConstants
from rollout.kernel.motion import separation
from rollout.kernel.planes import height_of


@sealed
def assign_relays(
    fleet: FleetConstants,
    relay: RelayConstants,
    position: Array,
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
        fresh: whether there is no step before.
        work: scratch.
        assignment: [n_m + n_d] relay of each served UAV; updated.
        linked: [n_m + n_d] out: 1 where the relay is within link range (W4).
        quality: [n_m + n_d] out: signal-to-noise ratio of the link to the relay, dB.
    """
    for served in range(len(assignment)):
        for i in range(fleet.relays):
            distance = separation(fleet, position, i, fleet.relays + served)
            loss = relay.loss_scale * math.log(max(distance * distance, LEAST_LINK)) + relay.loss_offset
            work.distance[served, i], work.loss[served, i] = distance, loss
            work.pair[served, i] = relay.cost_distance * distance + relay.cost_link * loss
    if fresh or not settle(work.pair, assignment, relay.capacity, work.load, work.exchange, work.mover):
        for served in range(len(assignment)):
            for i in range(fleet.relays):
                for place in range(relay.capacity):
                    work.cost[served, i * relay.capacity + place] = work.pair[served, i]
        assign(work.cost, work.numbers, work.indices, assignment)
        for served in range(len(assignment)):
            assignment[served] //= relay.capacity
    for served in range(len(assignment)):
        i = assignment[served]
        linked[served] = 1.0 if work.distance[served, i] <= relay.link_range else 0.0
        quality[served] = relay.budget - work.loss[served, i]


@sealed
def serve(
    fleet: FleetConstants,
    relay: RelayConstants,
    position: Array,
    assignment: Indices,
    service: Array,
    centroid: Array,
    farthest: Indices,
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
    """
    count = fleet.relays
    centroid[count, :] = 0.0
    for i in range(count):
        x, y, z, number, far = 0.0, 0.0, 0.0, 0, -1.0
        farthest[i] = -1
        for served in range(len(assignment)):
            if assignment[served] == i:
                u = count + served
                x, y, z, number = x + position[u, 0], y + position[u, 1], z + height_of(fleet, u), number + 1
                distance = separation(fleet, position, i, u)
                if distance > far:
                    far, farthest[i] = distance, u
        share = 1.0 / max(number, 1)
        centroid[i, 0], centroid[i, 1], centroid[i, 2] = x * share, y * share, z * share
        service[i] = relay.weight_farthest * max(far, 0.0)
        centroid[count, 0] += position[i, 0] / count
        centroid[count, 1] += position[i, 1] / count
        centroid[count, 2] += height_of(fleet, i) / count
    for i in range(count):
        if farthest[i] >= 0:
            service[i] += relay.weight_centroid * _to_point(fleet, position, i, centroid[i])
        service[i] += relay.weight_relays * _to_point(fleet, position, i, centroid[count])


@sealed
def _to_point(fleet: FleetConstants, position: Array, u: int, point: Array) -> float:
    dx, dy, dz = point[0] - position[u, 0], point[1] - position[u, 1], point[2] - height_of(fleet, u)
    return math.sqrt(dx * dx + dy * dy + dz * dz)
