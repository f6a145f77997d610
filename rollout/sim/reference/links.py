"""What the reference farm's UAVs see of their links, and relays of the links to the UAVs that they serve."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from rollout.sim.reference.farm import ReferenceFarm

Array = NDArray[np.float64]


def _slack(farm: ReferenceFarm, a: int, b: int, where: Array) -> Array:
    """Return link range less distance, m, for UAV a at several places [K, 2] while b stays where it is."""
    flat = ((where - farm.position[b]) ** 2).sum(axis=1)
    distance = np.sqrt(flat + (farm.height[a] - farm.height[b]) ** 2)
    return np.asarray(farm.config.relay.link_range - distance)


def link_view(farm: ReferenceFarm, u: int, signs: Array, goals: Array) -> Array:
    """Return a UAV's offset to its relay, the link's slack and state, and its slack after each move.

    Args:
        farm: the farm.
        u: a UAV with a task.
        signs: of its axes.
        goals: [9, 2] where its moves lead, m.
    """
    world = farm.config.world
    relay = farm.assignment[u - world.communication_uavs]
    if relay < 0:
        return np.array([0.0, 0.0, -1.0, 0.0, *[-1.0] * 9])
    offset = (farm.position[relay] - farm.position[u]) / (world.field_x, world.field_y) * signs
    (now,) = _slack(farm, u, relay, farm.position[u][None])
    share, then = now / farm.config.relay.link_range, _slack(farm, u, relay, goals) / _step(farm)
    return np.array([*offset, max(-1.0, share), float(now >= 0.0), *np.clip(then, -1.0, 1.0)])


def links_view(farm: ReferenceFarm, u: int, signs: Array, goals: Array) -> Array:
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
    if not served:
        return np.concatenate([view.reshape(-1), np.ones(18)])
    then = np.array([_slack(farm, u, other, goals) for other in served])
    least = np.clip(then / _step(farm), -1.0, 1.0).min(axis=0)
    return np.concatenate([view.reshape(-1), (then >= 0.0).mean(axis=0), least])


def _step(farm: ReferenceFarm) -> float:
    """Return the length of a diagonal step at full speed, m."""
    world = farm.config.world
    return math.hypot(world.speed_x_max, world.speed_y_max) * world.step_seconds
