"""What each of nine moves does to a relay's D_c while nobody else moves and the assignment stays."""

import math

from eia_sec.rollout.sim.core.compile import allocation_free
from eia_sec.rollout.sim.core.constants import FleetConstants, RelayConstants
from eia_sec.rollout.sim.core.records import Array, Float32, Indices


@allocation_free
def put_service(
    fleet: FleetConstants,
    relay: RelayConstants,
    per_step: float,
    position: Array,
    assignment: Indices,
    relays: int,
    centroid: Array,
    service: float,
    u: int,
    go_x: Array,
    go_y: Array,
    seen: Float32,
    at: int,
) -> int:
    """Write D_c over the field's diagonal and its change over a diagonal step for each move; return where they end."""
    seen[at] = service * fleet.per_diagonal
    at += 1
    for move in range(9):
        x, y = go_x[move // 3], go_y[move % 3]
        then = _service(fleet, relay, position, assignment, relays, centroid, u, x, y)
        seen[at + move] = (then - service) * per_step
    return at + 9


@allocation_free
def _service(
    fleet: FleetConstants,
    relay: RelayConstants,
    position: Array,
    assignment: Indices,
    relays: int,
    centroid: Array,
    u: int,
    x: float,
    y: float,
) -> float:
    """Return D_c of a relay that stands at (x, y), m."""
    far, height = -1.0, fleet.height[u]
    for served in range(len(assignment)):
        if assignment[served] == u:
            other = fleet.relays + served
            dx, dy = position[other, 0] - x, position[other, 1] - y
            dz = fleet.height[other] - height
            far = max(far, dx * dx + dy * dy + dz * dz)
    moved_x, moved_y = (x - position[u, 0]) / relays, (y - position[u, 1]) / relays
    dx, dy = centroid[fleet.relays, 0] + moved_x - x, centroid[fleet.relays, 1] + moved_y - y
    amount = relay.weight_relays * math.sqrt(dx * dx + dy * dy)
    if far >= 0.0:
        dx, dy, dz = centroid[u, 0] - x, centroid[u, 1] - y, centroid[u, 2] - height
        amount += relay.weight_farthest * math.sqrt(far)
        amount += relay.weight_centroid * math.sqrt(dx * dx + dy * dy + dz * dz)
    return amount
