"""When the UAVs of an episode fail, and which ones are missing from the start."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.seeds import stream

NEVER: Final = 2**30
"""A step that no episode reaches and that fits into 32 bits."""
HOUR: Final = 3600.0
"""s."""


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
