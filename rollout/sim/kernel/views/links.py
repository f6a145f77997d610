"""The links between UAVs and their relays, as both ends observe them.

A link of range R over a distance d is up while d <= R. Its slack is R - d: over R for the present, and over the length
of a diagonal step at full speed for what each of nine moves would leave. Both are clipped to -1..1, and the other end
stays where it is.

With a base station, UAVs see whether their relay is joined to it, and relays what their own moves would do to the
chain.
"""

import math

import numpy as np
from numpy.typing import NDArray

from eia_sec.rollout.sim.kernel.arrays import Farm, Scratch
from eia_sec.rollout.sim.kernel.chain import join_relays
from eia_sec.rollout.sim.kernel.compiler.decorators import allocation_free, inlined
from eia_sec.rollout.sim.kernel.constants import Array, Constants, FleetConstants, Indices
from eia_sec.rollout.sim.kernel.flight.failures import NOBODY
from eia_sec.rollout.sim.kernel.flight.planes import height_of
from eia_sec.rollout.sim.kernel.views.constants import ViewConstants

Float32 = NDArray[np.float32]
Flags = NDArray[np.bool_]


@allocation_free
def _distance(fleet: FleetConstants, position: Array, u: int, other: int, x: float, y: float) -> float:
    """Return the distance between another UAV and a UAV that stands at (x, y), m."""
    dx, dy = position[other, 0] - x, position[other, 1] - y
    dz = height_of(fleet, other) - height_of(fleet, u)
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@allocation_free
def _clipped(slack: float) -> float:
    return min(1.0, max(-1.0, slack))


@allocation_free
def put_link(
    fleet: FleetConstants,
    view: ViewConstants,
    position: Array,
    relay: int,
    u: int,
    sx: float,
    sy: float,
    go_x: Array,
    go_y: Array,
    seen: Float32,
    at: int,
) -> int:
    """Write offset, slack and state of the link to a UAV's relay, and the slack after each move; return where they end.

    A UAV without a relay sees (0, 0) and the least slack.
    """
    seen[at], seen[at + 1], seen[at + 2], seen[at + 3] = 0.0, 0.0, -1.0, 0.0
    if relay != NOBODY:
        x, y = position[u, 0], position[u, 1]
        distance = _distance(fleet, position, u, relay, x, y)
        seen[at] = sx * (position[relay, 0] - x) * fleet.per_width
        seen[at + 1] = sy * (position[relay, 1] - y) * fleet.per_depth
        seen[at + 2] = _clipped((view.link_range - distance) / view.link_range)
        seen[at + 3] = 1.0 if distance <= view.link_range else 0.0
    at += 4
    for move in range(9):
        seen[at + move] = -1.0
        if relay != NOBODY:
            distance = _distance(fleet, position, u, relay, go_x[move // 3], go_y[move % 3])
            seen[at + move] = _clipped((view.link_range - distance) * view.per_step)
    return at + 9


@allocation_free
def put_links(
    fleet: FleetConstants,
    view: ViewConstants,
    position: Array,
    assignment: Indices,
    u: int,
    sx: float,
    sy: float,
    go_x: Array,
    go_y: Array,
    seen: Float32,
    at: int,
) -> int:
    """Write the links of a relay; return where they end.

    First offset, slack and presence of the UAVs that it serves, zeros for places that are free; then for each
    move the share of the links that would be up, and the least slack. Without a UAV these are 1.
    """
    found, x, y = 0, position[u, 0], position[u, 1]
    for served in range(len(assignment)):
        if assignment[served] == u and found < view.served:
            other = fleet.relays + served
            distance = _distance(fleet, position, u, other, x, y)
            seen[at] = sx * (position[other, 0] - x) * fleet.per_width
            seen[at + 1] = sy * (position[other, 1] - y) * fleet.per_depth
            seen[at + 2] = _clipped((view.link_range - distance) / view.link_range)
            seen[at + 3] = 1.0
            at, found = at + 4, found + 1
    for place in range(at, at + 4 * (view.served - found)):
        seen[place] = 0.0
    at += 4 * (view.served - found)
    for move in range(9):
        up, least = _kept(fleet, view, position, assignment, u, go_x[move // 3], go_y[move % 3])
        seen[at + move], seen[at + 9 + move] = up, least
    return at + 18


@allocation_free
def _kept(
    fleet: FleetConstants, view: ViewConstants, position: Array, assignment: Indices, u: int, x: float, y: float
) -> tuple[float, float]:
    """Return the share of a relay's links that are up, and their least slack, if it stands at (x, y)."""
    count, up, least = 0, 0, 1.0
    for served in range(len(assignment)):
        if assignment[served] == u:
            distance = _distance(fleet, position, u, fleet.relays + served, x, y)
            count += 1
            up += 1 if distance <= view.link_range else 0
            least = min(least, _clipped((view.link_range - distance) * view.per_step))
    return (up / count if count > 0 else 1.0), least


@inlined
def put_chain(c: Constants, farm: Farm, s: Scratch, u: int, at: int) -> int:
    """Write a relay's view of the chain to the base station; return where it ends.

    It is the offset to the base station, 1 if the relay is joined, and for each move the share of the living relays
    that would be joined.
    """
    chain, fleet, v, seen, position = c.chain, c.fleet, s.added, farm.observation, farm.position
    seen[at] = v.sign[u, 0] * (chain.x - position[u, 0]) * fleet.per_width
    seen[at + 1] = v.sign[u, 1] * (chain.y - position[u, 1]) * fleet.per_depth
    seen[at + 2] = 1.0 if s.joined[u] else 0.0
    at += 3
    for move in range(9):
        x, y = v.go_x[u, move // 3], v.go_y[u, move % 3]
        seen[at + move] = join_relays(chain, position, farm.gone, u, x, y, s.joined_then, s.queue) / farm.living[0]
    return at + 9


@allocation_free
def put_joined(relay: int, joined: Flags, seen: Float32, at: int) -> int:
    """Write 1 if a UAV has a relay that is joined; return where that ends."""
    seen[at] = 1.0 if relay != NOBODY and joined[relay] else 0.0
    return at + 1
