"""Communication UAVs: whom each serves, and how well it stands."""

import math

from rollout.kernel.assignment import assign
from rollout.kernel.compiled import compiled
from rollout.kernel.constants import LEAST_LINK, Array, FleetConstants, Indices, RelayConstants
from rollout.kernel.motion import separation
from rollout.kernel.planes import height_of


@compiled
def assign_relays(
    fleet: FleetConstants,
    relay: RelayConstants,
    position: Array,
    cost: Array,
    numbers: Array,
    indices: Indices,
    assignment: Indices,
    linked: Array,
) -> None:
    """Assign every monitoring and data collection UAV to a relay (W2, W3).

    The cost of a pair is cost_distance d / diagonal + cost_link FSPL(d) / FSPL(diagonal); every relay stands in
    `capacity` columns.

    Args:
        fleet: the UAVs.
        relay: weights and capacity.
        position: [n, 2] m.
        cost: [n_m + n_d, n_c capacity] scratch.
        numbers: scratch of `assign`.
        indices: scratch of `assign`.
        assignment: [n_m + n_d] out: relay of each served UAV.
        linked: [n_m + n_d] out: 1 where the relay is within link range (W4).
    """
    for served in range(len(assignment)):
        for i in range(fleet.relays):
            distance = separation(fleet, position, i, fleet.relays + served)
            loss = 20.0 * math.log10(max(distance, LEAST_LINK)) + relay.loss_offset
            value = relay.cost_distance * distance + relay.cost_link * loss
            for place in range(relay.capacity):
                cost[served, i * relay.capacity + place] = value
    assign(cost, numbers, indices, assignment)
    for served in range(len(assignment)):
        assignment[served] //= relay.capacity
        distance = separation(fleet, position, assignment[served], fleet.relays + served)
        linked[served] = 1.0 if distance <= relay.link_range else 0.0


@compiled
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


@compiled
def _to_point(fleet: FleetConstants, position: Array, u: int, point: Array) -> float:
    dx, dy, dz = point[0] - position[u, 0], point[1] - position[u, 1], point[2] - height_of(fleet, u)
    return math.sqrt(dx * dx + dy * dy + dz * dz)
