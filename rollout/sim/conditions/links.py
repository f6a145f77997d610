"""Links between UAVs and relays, and chains of relays to the base station: which are up, and what both ends see.

A relay is joined while hops of at most the hop range, over living relays, lead from it to the base station. A hop's
length is three-dimensional: relays fly at their height, and the base station stands on the ground.

A link of range R over a distance d is up while d <= R. Its slack is R - d: over R for the present, and over the length
of a diagonal step at full speed for what each of nine moves would leave. Both are clipped to -1..1, and the other end
stays where it is. With a base station, UAVs see whether their relay is joined to it, and relays what their own moves
would do to the chain.
"""

import math

import numpy as np

from eia_sec.common.config import FarmConfig
from eia_sec.rollout.sim.conditions.failures import NOBODY
from eia_sec.rollout.sim.core.arrays import Farm, Scratch
from eia_sec.rollout.sim.core.compile import allocation_free, inlined
from eia_sec.rollout.sim.core.constants import Constants, FleetConstants, RelayConstants
from eia_sec.rollout.sim.core.planes import height_of
from eia_sec.rollout.sim.core.records import Array, Flags, Float32, Indices
from eia_sec.rollout.sim.observation.constants import ViewConstants
from eia_sec.rollout.sim.stations import base_place


def relay_gaps(config: FarmConfig, places: Array) -> tuple[Array, Array]:
    """Return the distances between relays, [..., n_c, n_c] m, and from each to the base station, [..., n_c] m.

    Args:
        config: a farm with a base station.
        places: [..., n_c, 2] of the relays, m.
    """
    between = np.sqrt(((places[..., :, None, :] - places[..., None, :, :]) ** 2).sum(axis=-1))
    flat = ((places - base_place(config)) ** 2).sum(axis=-1)
    return between, np.sqrt(flat + config.world.height_communication**2)


def joined_relays(config: FarmConfig, places: Array, gone: Flags | None = None) -> Flags:
    """Return which relays hops within range lead from to the base station, [..., n_c].

    Args:
        config: the farm. Without a base station all living relays count as joined.
        places: [..., n_c, 2] of the relays, m.
        gone: [..., n_c] whether a relay has failed; nobody by default.
    """
    living = np.ones(places.shape[:-1], np.bool_) if gone is None else ~gone
    if not config.relay.chained:
        return living
    between, down = relay_gaps(config, places)
    near = between <= config.relay.hop_range
    joined = (down <= config.relay.hop_range) & living
    for _ in range(places.shape[-2] - 1):
        joined = joined | ((near & joined[..., None, :]).any(axis=-1) & living)
    return joined


@allocation_free
def join_relays(
    relay: RelayConstants,
    position: Array,
    gone: Flags,
    moved: int,
    to_x: float,
    to_y: float,
    joined: Flags,
    queue: Indices,
) -> int:
    """Write which relays are joined, from the base station on outwards; return their number.

    Args:
        relay: constants.
        position: [n, 2] of all UAVs, m; relays come first.
        gone: [n] whether a UAV has failed.
        moved: a relay that stands elsewhere, or -1 for none.
        to_x: where it stands, m; infinite to leave it out.
        to_y: the same along y.
        joined: [n_c] whether each relay is joined.
        queue: [n_c] scratch.
    """
    count, done = 0, 0
    for i in range(len(joined)):
        x, y = (to_x, to_y) if i == moved else (position[i, 0], position[i, 1])
        joined[i] = not gone[i] and _within(relay, x - relay.base_x, y - relay.base_y, relay.height)
        if joined[i]:
            queue[count] = i
            count += 1
    while done < count:
        j = queue[done]
        from_x, from_y = (to_x, to_y) if j == moved else (position[j, 0], position[j, 1])
        done += 1
        for i in range(len(joined)):
            if not joined[i] and not gone[i]:
                x, y = (to_x, to_y) if i == moved else (position[i, 0], position[i, 1])
                if _within(relay, x - from_x, y - from_y, 0.0):
                    joined[i] = True
                    queue[count] = i
                    count += 1
    return count


@allocation_free
def _within(relay: RelayConstants, dx: float, dy: float, dz: float) -> bool:
    within: bool = math.sqrt(dx * dx + dy * dy + dz * dz) <= relay.hop_range
    return within


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
    relay, fleet, v, seen, position = c.relay, c.fleet, s.added, farm.observation, farm.position
    seen[at] = v.sign[u, 0] * (relay.base_x - position[u, 0]) * fleet.per_width
    seen[at + 1] = v.sign[u, 1] * (relay.base_y - position[u, 1]) * fleet.per_depth
    seen[at + 2] = 1.0 if s.joined[u] else 0.0
    at += 3
    for move in range(9):
        x, y = v.go_x[u, move // 3], v.go_y[u, move % 3]
        seen[at + move] = join_relays(relay, position, farm.gone, u, x, y, s.joined_then, s.queue) / farm.living[0]
    return at + 9


@allocation_free
def put_joined(relay: int, joined: Flags, seen: Float32, at: int) -> int:
    """Write 1 if a UAV has a relay that is joined; return where that ends."""
    seen[at] = 1.0 if relay != NOBODY and joined[relay] else 0.0
    return at + 1
