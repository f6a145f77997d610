"""UAVs that fail: when they do in an episode, and what that does to a farm.

From the step of its failure on, a UAV is gone. A UAV that is gone is infinitely far away. So it is nobody's nearest
UAV, no plot and no sensor is its own, and nobody comes close to it; the search loops need not know. What reads one
UAV's own position asks `gone` first. `shown` keeps where it failed, for the public.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.seeds import stream
from eia_sec.rollout.sim.core.arrays import Farm
from eia_sec.rollout.sim.core.compile import allocation_free, inlined
from eia_sec.rollout.sim.core.constants import Constants
from eia_sec.rollout.sim.core.planes import kind_of
from eia_sec.rollout.sim.core.records import Float32, Indices

NEVER: Final = 2**30
"""A step that no episode reaches and that fits into 32 bits."""
HOUR: Final = 3600.0
"""s."""
NOBODY: Final = -1
"""The relay of a UAV that has none."""


def failure_steps(config: FarmConfig, farm_seed: int, episode_seed: int) -> NDArray[np.int64]:
    """Return the first step of which each UAV is no part, from 1 on, [n]; NEVER for none, 1 for one that is missing.

    The time to a failure is exponential, so a UAV fails in any step with the same probability. The draws do not depend
    on the rate: at a higher one, every UAV fails sooner.
    """
    world, failures = config.world, config.failures
    steps = np.full(world.uavs, NEVER, np.int64)
    if failures.per_hour > 0.0:
        lives = stream(farm_seed, episode_seed, "failures").exponential(size=world.uavs)
        flown = lives * (HOUR / failures.per_hour) / world.step_seconds
        steps = 1 + np.minimum(flown, NEVER - 1).astype(np.int64)
    first = (0, world.communication_uavs, world.communication_uavs + world.monitoring_uavs)
    for kind, rank, step in failures.given():
        u = first[kind] + rank
        steps[u] = min(steps[u], step)
    if failures.missing > 0.0:
        draws = stream(farm_seed, episode_seed, "missing").random(world.uavs)
        for start, count in zip(first, world.counts, strict=True):
            own = draws[start : start + count]
            steps[start : start + count][(own < failures.missing) & (own < own.max())] = 1
    return steps


@inlined
def lose_uavs(c: Constants, farm: Farm) -> bool:
    """Take the UAVs that fail in this step out of the farm; return whether there are any.

    Updates `gone`, `living`, `position` and `direction`.
    """
    lost = False
    for u in range(len(farm.gone)):
        if not farm.gone[u] and farm.failure[u] <= farm.time[0]:
            farm.gone[u], lost = True, True
            farm.living[kind_of(c.fleet, u)] -= 1
            farm.position[u, 0], farm.position[u, 1] = math.inf, math.inf
            farm.direction[u, 0], farm.direction[u, 1] = 0.0, 0.0
    return lost


@inlined
def show_places(farm: Farm) -> None:
    """Write where the UAVs are to `shown`; one that is gone stays there where it failed."""
    for u in range(len(farm.gone)):
        if not farm.gone[u]:
            farm.shown[u, 0], farm.shown[u, 1] = farm.position[u, 0], farm.position[u, 1]


@allocation_free
def capacity_left(capacity: int, living: Indices) -> int:
    """Return how many UAVs each living relay serves: more than its capacity only if not all would be served else."""
    served, relays = living[1] + living[2], max(living[0], 1)
    most: int = max(capacity, (served + relays - 1) // relays)
    return most


@allocation_free
def see_nothing(size: int, seen: Float32, at: int) -> int:
    """Write the observation of a UAV that is gone, zeros; return where it ends."""
    for k in range(at, at + size):
        seen[k] = 0.0
    return at + size


@allocation_free
def put_alive(living: int, count: int, seen: Float32, at: int) -> int:
    """Write the share of a type's UAVs that have not failed; return where it ends."""
    seen[at] = living / count
    return at + 1
