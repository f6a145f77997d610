"""The wind of an episode."""

import math

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.farm.wind import SEEDED
from eia_sec.common.seeds import stream

Array = NDArray[np.float64]


def wind_series(config: FarmConfig, farm_seed: int, episode_seed: int) -> Array:
    """Return the wind along x and y, [steps + 1, 2] m/s; row k blows during step k, row 0 before the first.

    A steady wind, and gusts along each axis: a first-order autoregressive process, the sampled Ornstein-Uhlenbeck
    process, which begins in its stationary distribution. Along an axis the wind never exceeds the UAVs' top speed, so
    that every UAV can hold its place.

    Returns:
        no rows if there is no wind.
    """
    world, wind = config.world, config.wind
    if not wind.some:
        return np.zeros((0, 2))
    from scipy.signal import lfilter  # noqa: PLC0415  (half of a worker's start went into this import, and few farms have wind)

    random = stream(farm_seed, episode_seed, "wind")
    seeded = 360.0 * random.random()
    bearing = math.radians(seeded if wind.direction == SEEDED else wind.direction)
    steady = -wind.speed * np.array([math.sin(bearing), math.cos(bearing)])
    kept = math.exp(-world.step_seconds / wind.gust_seconds)
    shocks = wind.gusts * random.standard_normal((world.steps + 1, 2))
    shocks[1:] *= math.sqrt(1.0 - kept * kept)
    top = np.array([world.speed_x_max, world.speed_y_max])
    blown: Array = np.clip(steady + lfilter([1.0], [1.0, -kept], shocks, axis=0), -top, top)
    return blown
