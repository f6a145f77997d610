"""The reference farm's chains to the base station, what links are worth, and what UAVs and relays see of them."""

import math

import numpy as np
from numpy.typing import NDArray

from eia_sec.rollout.sim.reference.state import FarmState
from eia_sec.rollout.sim.stations import base_place

Array = NDArray[np.float64]


def joined_to_base(farm: FarmState, without: int = -1) -> NDArray[np.bool_]:
    """Return which relays hops lead from to the base station, [n_c], without one of the relays if it is given."""
    world, most = farm.config.world, farm.config.relay.hop_range
    places = np.column_stack([farm.position, farm.height])[: world.communication_uavs]
    base, joined = np.append(base_place(farm.config), 0.0), np.zeros(world.communication_uavs, bool)
    ends, left = [base], [int(r) for r in farm.living(0) if r != without]
    while ends:
        end = ends.pop()
        found = [r for r in left if np.linalg.norm(places[r] - end) <= most]
        joined[found] = True
        left = [r for r in left if r not in found]
        ends += [places[r] for r in found]
    return joined


def relayed(farm: FarmState, relay: int) -> float:
    """Return what UAVs earn per second and would not without a relay's links and hops, which would make them idle."""
    weight, amount = farm.config.reward, 0.0
    if not farm.config.relay.require_link:
        return amount
    cut = farm.assignment == relay
    if farm.config.relay.chained:
        cut |= (farm.joined & ~joined_to_base(farm, relay))[farm.assignment]
    for u in np.flatnonzero(cut & farm.linked) + farm.config.world.communication_uavs:
        if farm.utility[u] > 0.0:
            monitor = farm.kind[u] == 1
            amount += (weight.monitoring if monitor else weight.collection) * farm.utility[u]
            amount += weight.monitoring_idle if monitor else weight.collection_idle
    return float(amount)


def _slack(farm: FarmState, a: int, b: int, where: Array) -> Array:
    """Return link range less distance, m, for UAV a at several places [K, 2] while b stays where it is."""
    flat = ((where - farm.position[b]) ** 2).sum(axis=1)
    distance = np.sqrt(flat + (farm.height[a] - farm.height[b]) ** 2)
    return np.asarray(farm.config.relay.link_range - distance)


def link_view(farm: FarmState, u: int, signs: Array, goals: Array) -> Array:
    """Return a UAV's offset to its relay, the link's slack and state, its slack after each move; 1 if it is joined.

    Args:
        farm: the farm.
        u: a UAV with a task.
        signs: of its axes.
        goals: [9, 2] where its moves lead, m.
    """
    world = farm.config.world
    relay = farm.assignment[u - world.communication_uavs]
    joined = [float(relay >= 0 and farm.joined[relay])] * farm.config.relay.chained
    if relay < 0:
        return np.array([0.0, 0.0, -1.0, 0.0, *[-1.0] * 9, *joined])
    offset = (farm.position[relay] - farm.position[u]) / (world.field_x, world.field_y) * signs
    (now,) = _slack(farm, u, relay, farm.position[u][None])
    share, then = now / farm.config.relay.link_range, _slack(farm, u, relay, goals) / _step(farm)
    return np.array([*offset, max(-1.0, share), float(now >= 0.0), *np.clip(then, -1.0, 1.0), *joined])


def links_view(farm: FarmState, u: int, signs: Array, goals: Array) -> Array:
    """Return a relay's view of the UAVs that it serves, and of all its links after each move.

    Args:
        farm: the farm.
        u: the relay.
        signs: of its axes.
        goals: [9, 2] where its moves lead, m.
    """
    world, served = farm.config.world, farm.served(u)
    size = np.array([world.field_x, world.field_y])
    most = farm.config.relay.capacity_for(world)
    view = np.zeros((most, 4))
    for row, other in zip(view, served, strict=False):
        (now,) = _slack(farm, u, other, farm.position[u][None])
        row[:2] = (farm.position[other] - farm.position[u]) / size * signs
        row[2:] = max(-1.0, now / farm.config.relay.link_range), 1.0
    chain = _chain(farm, u, signs, goals) if farm.config.relay.chained else np.zeros(0)
    if not served:
        return np.concatenate([view.reshape(-1), np.ones(18), chain])
    then = np.array([_slack(farm, u, other, goals) for other in served])
    least = np.clip(then / _step(farm), -1.0, 1.0).min(axis=0)
    return np.concatenate([view.reshape(-1), (then >= 0.0).mean(axis=0), least, chain])


def _chain(farm: FarmState, u: int, signs: Array, goals: Array) -> Array:
    """Return a relay's offset to the base station, 1 if it is joined, and the share joined after each move."""
    world, here, shares = farm.config.world, farm.position[u].copy(), []
    offset = (base_place(farm.config) - here) / (world.field_x, world.field_y) * signs
    for goal in goals:
        farm.position[u] = goal
        shares.append(joined_to_base(farm).sum() / len(farm.living(0)))
    farm.position[u] = here
    return np.array([*offset, float(farm.joined[u]), *shares])


def _step(farm: FarmState) -> float:
    """Return the length of a diagonal move at full speed, m."""
    world = farm.config.world
    return math.hypot(world.speed_x_max, world.speed_y_max) * world.step_seconds * farm.move_steps
