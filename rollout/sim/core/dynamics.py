"""Flight with inertia: how a velocity changes under limits of acceleration and jerk, in closed form.

An autopilot leads each axis of the velocity to the commanded one as fast as its limits allow: the acceleration rises at
the largest jerk, stays at its limit, and falls again, so that it is 0 when the velocity is reached. PX4's trajectory
generator (`VelocitySmoothing`) does the same. A command counts from `delay` after the step's beginning; until then the
former one does. Where the field's border or a zone stops a UAV, it stands, and its command is to stand.
"""

import math
from typing import Annotated, Final, NamedTuple

import numpy as np

from eia_sec.common.config import FarmConfig
from eia_sec.rollout.sim.core.compile import allocation_free
from eia_sec.rollout.sim.core.records import Array

VELOCITY: Final = 0
ACCELERATION: Final = 2
COMMAND: Final = 4
"""First columns of a UAV's motion, two each: velocity, acceleration, and the velocity commanded last."""
EVER: Final = 1e9
"""Time in which every UAV has stopped, s."""


class DynamicsConstants(NamedTuple):
    """Limits of each type; those of time and way are without effect unless `some`."""

    some: Annotated[bool, "whether UAVs need time to change their velocity"]
    acceleration: Annotated[Array, "[3] of each type along each axis, m/s^2"]
    jerk: Annotated[Array, "[3] the same, m/s^3"]
    delay: Annotated[Array, "[3] time until a command counts, s"]
    speed: Annotated[Array, "[3] top speed over ground along each axis, m/s"]
    airspeed: Annotated[Array, "[3] top speed through the air along each axis, m/s"]


def dynamics_constants(config: FarmConfig) -> DynamicsConstants:
    """Return the limits of a farm's UAVs."""
    limits = (np.array(config.dynamics.of_types(name)) for name in DynamicsConstants._fields[1:])
    return DynamicsConstants(config.dynamics.inertial, *limits)


@allocation_free
def glide(
    velocity: float, acceleration: float, wanted: float, most: float, jerk: float, seconds: float
) -> tuple[float, float, float]:
    """Lead the velocity along an axis to a wanted one for some time.

    The peak p of the acceleration follows from the velocity to be gained, dv = (2 p^2 - a^2) / (2 jerk) where the limit
    is not reached.

    Args:
        velocity: at the beginning, m/s.
        acceleration: at the beginning, within `most`, m/s^2.
        wanted: velocity to reach, m/s.
        most: limit of the acceleration, m/s^2.
        jerk: its limit, m/s^3.
        seconds: how long.

    Returns:
        the way, m, and the velocity and the acceleration at the end.
    """
    level = velocity + 0.5 * acceleration * abs(acceleration) / jerk
    sign = 1.0 if wanted >= level else -1.0
    v, a, gain = sign * velocity, sign * acceleration, sign * (wanted - velocity)
    peak = math.sqrt(max(0.0, jerk * gain + 0.5 * a * a))
    hold = 0.0
    if peak > most:
        hold = (gain - (most * most - 0.5 * a * a) / jerk) / most
        peak = most
    left, way = seconds, 0.0
    t = min(left, max(0.0, (peak - a) / jerk))
    way += t * (v + t * (0.5 * a + t * jerk / 6.0))
    v, a, left = v + t * (a + 0.5 * t * jerk), a + t * jerk, left - t
    t = min(left, hold)
    way, v, left = way + t * (v + 0.5 * t * a), v + t * a, left - t
    t = min(left, peak / jerk)
    way += t * (v + t * (0.5 * a - t * jerk / 6.0))
    v, a, left = v + t * (a - 0.5 * t * jerk), a - t * jerk, left - t
    if left > 0.0:
        v, a = sign * wanted, 0.0
        way += left * v
    return sign * way, sign * v, sign * a


@allocation_free
def follow(
    d: DynamicsConstants, kind: int, motion: Array, axis: int, command: float, seconds: float
) -> tuple[float, float, float]:
    """Return the way, velocity and acceleration along an axis after a step with a new command; changes nothing."""
    most, jerk, delay = d.acceleration[kind], d.jerk[kind], d.delay[kind]
    v, a = motion[VELOCITY + axis], motion[ACCELERATION + axis]
    first, v, a = glide(v, a, motion[COMMAND + axis], most, jerk, delay)
    then, v, a = glide(v, a, command, most, jerk, seconds - delay)
    return first + then, v, a


@allocation_free
def stopping_way(d: DynamicsConstants, kind: int, velocity: float, acceleration: float, command: float) -> float:
    """Return the way along an axis until a UAV stands that is told to, while it flies to an earlier command, m."""
    most, jerk = d.acceleration[kind], d.jerk[kind]
    first, v, a = glide(velocity, acceleration, command, most, jerk, d.delay[kind])
    then, _, _ = glide(v, a, 0.0, most, jerk, EVER)
    return first + then
