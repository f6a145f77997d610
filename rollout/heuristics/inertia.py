"""Flight with inertia, for heuristics: how far commands lead, which command stops at a place, and how long a way takes.

All of it is for many UAVs at once. A UAV's motion is its velocity, its acceleration and its last command, as in
`FarmBatch.motion`.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.rollout.sim.core import dynamics as core
from eia_sec.rollout.sim.core.compile import compiled_entry

Array = NDArray[np.float64]

HALVINGS: Final = 16
"""Halvings of the interval in which the command that stops at a place is sought."""


def glide(v: Array, a: Array, wanted: Array, most: Array, jerk: Array, seconds: Array | float) -> tuple[Array, ...]:
    """Return ways, velocities and accelerations of many UAVs after some time; see `core.dynamics.glide`."""
    arrays = np.broadcast_arrays(v, a, wanted, most, jerk, seconds)
    found = _glides(*(np.ascontiguousarray(array, np.float64).ravel() for array in arrays))
    return tuple(part.reshape(arrays[0].shape) for part in found)


@compiled_entry
def _glides(v: Array, a: Array, wanted: Array, most: Array, jerk: Array, seconds: Array) -> Array:
    found = np.empty((3, len(v)))
    for index in range(len(v)):
        found[0, index], found[1, index], found[2, index] = core.glide(
            v[index], a[index], wanted[index], most[index], jerk[index], seconds[index]
        )
    return found


class Inertia:
    """The limits of a farm's UAVs.

    Args:
        config: a farm with `dynamics.model` inertial.
        kinds: the type of each UAV, [n].

    Attributes:
        top: top speed along each axis, [n, 2] m/s.
    """

    def __init__(self, config: FarmConfig, kinds: NDArray[np.int64]) -> None:
        most, jerk, delay, speed = (
            np.array(config.dynamics.of_types(name))[kinds][:, None]
            for name in ("acceleration", "jerk", "delay", "speed")
        )
        self._most, self._jerk, self._delay, self._seconds = most, jerk, delay, config.world.step_seconds
        self.top: Array = np.minimum(speed, (config.world.speed_x_max, config.world.speed_y_max))

    def stopping_way(self, motion: Array, command: Array) -> Array:
        """Return the ways [.., n, 2] m of a step with commands [.., n, 2] m/s and of braking after it.

        Args:
            motion: [.., n, 6].
            command: [.., n, 2] m/s.
        """
        v, a, before = motion[..., 0:2], motion[..., 2:4], motion[..., 4:6]
        parts = []
        for wanted, seconds in (
            (before, self._delay),
            (command, self._seconds - self._delay),
            (command, self._delay),
            (np.zeros_like(command), core.EVER),
        ):
            way, v, a = glide(v, a, wanted, self._most, self._jerk, seconds)
            parts.append(way)
        return np.asarray(sum(parts))

    def steer(self, motion: Array, way: Array) -> Array:
        """Return the fastest commands [.., n, 2] m/s after which UAVs can stop at the end of ways [.., n, 2] m."""
        low, high = np.broadcast_to(-self.top, way.shape), np.broadcast_to(self.top, way.shape)
        if not (motion.any() or way.any()):
            return np.zeros_like(way)
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            short = self.stopping_way(motion, middle) < way
            low, high = np.where(short, middle, low), np.where(short, high, middle)
        ends = np.where(low == -self.top, -self.top, np.where(high == self.top, self.top, 0.5 * (low + high)))
        return np.asarray(ends)

    def seconds_for(self, gap: Array) -> Array:
        """Return the time [..] s of ways [.., 2] m from rest to rest of the first UAV; the slower axis decides."""
        most, jerk, delay = (float(limit[0, 0]) for limit in (self._most, self._jerk, self._delay))
        return np.asarray(rest_seconds(np.abs(gap), most, jerk, delay, float(self.top[0].min())).max(axis=-1))


def rest_seconds(way: Array, most: float, jerk: float, delay: float, top: float) -> Array:
    """Return the time from rest to rest over ways [..] m along an axis, s.

    The velocity rises to a peak v and falls again. Where it reaches the largest acceleration that takes v / most +
    most / jerk each, else 2 sqrt(v / jerk); beyond the top speed the rest of the way is flown at it.
    """
    edge = most / jerk
    short = (way * np.sqrt(jerk) / 2.0) ** (2.0 / 3.0)
    long = 0.5 * most * (np.sqrt(edge * edge + 4.0 * way / most) - edge)
    peak = np.minimum(top, np.where(short <= most * edge, short, long))
    rising = np.where(peak <= most * edge, 2.0 * np.sqrt(peak / jerk), peak / most + edge)
    rest = np.maximum(0.0, way - peak * rising) / top
    return np.asarray(np.where(way > 0.0, delay + 2.0 * rising + rest, 0.0))
