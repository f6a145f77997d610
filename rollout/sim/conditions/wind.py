"""Wind: how it blows in an episode, what it does to flight, and what UAVs see of it.

The commanded velocity is that over ground. A UAV flies through air that moves with the wind w, so its airspeed is the
commanded velocity less w, along each axis clipped to the top speed; over ground it makes the airspeed plus w.
"""

import math

import numpy as np

from eia_sec.common.config import FarmConfig
from eia_sec.common.seeds import stream
from eia_sec.rollout.sim.core.compile import allocation_free
from eia_sec.rollout.sim.core.constants import FleetConstants
from eia_sec.rollout.sim.core.records import Array, Float32


def wind_series(config: FarmConfig, farm_seed: int, episode_seed: int) -> Array:
    """Return the wind along x and y, [steps + 1, 2] m/s; row k blows during step k, row 0 before the first.

    A steady wind from a drawn direction, and gusts along each axis: a first-order autoregressive process, the sampled
    Ornstein-Uhlenbeck process, which begins in its stationary distribution. Along an axis the wind never exceeds the
    UAVs' top speed through the air, so that every UAV can hold its place.

    Returns:
        no rows if there is no wind.
    """
    world, wind = config.world, config.wind
    if not wind.some:
        return np.zeros((0, 2))
    from scipy.signal import lfilter  # noqa: PLC0415  (half of a worker's start went into this import, and few farms have wind)

    random = stream(farm_seed, episode_seed, "wind")
    bearing = math.radians(360.0 * random.random())
    steady = -wind.speed * np.array([math.sin(bearing), math.cos(bearing)])
    kept = math.exp(-world.step_seconds / wind.gust_seconds)
    shocks = wind.gusts * random.standard_normal((world.steps + 1, 2))
    shocks[1:] *= math.sqrt(1.0 - kept * kept)
    top = np.array([world.speed_x_max, world.speed_y_max])
    if config.dynamics.inertial:
        top = np.minimum(top, min(config.dynamics.airspeed))
    blown: Array = np.clip(steady + lfilter([1.0], [1.0, -kept], shocks, axis=0), -top, top)
    return blown


@allocation_free
def ground_speed(commanded: float, wind: float, top: float) -> float:
    """Return the speed over ground along an axis, m/s: as commanded, where the airspeed is at most the top speed."""
    return min(wind + top, max(wind - top, commanded))


@allocation_free
def put_wind(fleet: FleetConstants, wind: Array, step: int, sx: float, sy: float, seen: Float32, at: int) -> int:
    """Write the wind of a step over full speed, 0 without wind [0, 2]; return where it ends."""
    seen[at], seen[at + 1] = 0.0, 0.0
    if len(wind) > 0:
        seen[at], seen[at + 1] = sx * wind[step, 0] / fleet.speed_x, sy * wind[step, 1] / fleet.speed_y
    return at + 2
