"""Flight with inertia on the reference farm: pieces of constant jerk, one axis at a time."""

import math

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config.farm.polygons import refused
from eia_sec.common.farm_observation import HOLD, farthest_stop
from eia_sec.rollout.sim.observation.inertia import ROUNDING
from eia_sec.rollout.sim.reference.axes import signs_of
from eia_sec.rollout.sim.reference.power import flight_power
from eia_sec.rollout.sim.reference.state import FarmState

Array = NDArray[np.float64]


def pieces(velocity: float, acceleration: float, wanted: float, most: float, jerk: float) -> list[tuple[float, float]]:
    """Return the pieces (seconds, jerk) that lead a velocity to a wanted one as fast as the limits allow.

    The acceleration goes to a peak, stays there if that is the limit, and goes to 0.
    """
    ending = velocity + acceleration * abs(acceleration) / (2.0 * jerk)  # the velocity if the acceleration ends now
    up = 1.0 if wanted >= ending else -1.0
    gain = up * (wanted - velocity)
    peak = min(most, math.sqrt(max(0.0, acceleration**2 / 2.0 + jerk * gain)))
    rise, fall = (peak - up * acceleration) / jerk, peak / jerk
    gained = (peak + up * acceleration) / 2.0 * rise + peak / 2.0 * fall
    steady = (gain - gained) / peak if peak == most else 0.0
    return [(max(0.0, rise), up * jerk), (max(0.0, steady), 0.0), (fall, -up * jerk)]


def course(
    velocity: float, acceleration: float, wanted: float, limits: tuple[float, float], seconds: float
) -> tuple[float, float, float]:
    """Return the way, the velocity and the acceleration after some time on the way to a wanted velocity."""
    way, left = 0.0, seconds
    for time, jerk in pieces(velocity, acceleration, wanted, *limits):
        t = min(time, left)
        way += velocity * t + acceleration * t**2 / 2.0 + jerk * t**3 / 6.0
        velocity += acceleration * t + jerk * t**2 / 2.0
        acceleration += jerk * t
        left -= t
    return (way + wanted * left, wanted, 0.0) if left > 0.0 else (way, velocity, acceleration)


def limits_of(farm: FarmState, u: int) -> tuple[tuple[float, float], float]:
    """Return the limits of a UAV's acceleration and jerk, and its delay."""
    most, jerk, delay = (
        farm.config.dynamics.of_types(name)[farm.kind[u]] for name in ("acceleration", "jerk", "delay")
    )
    return (most, jerk), delay


def after(farm: FarmState, u: int, axis: int, command: float, steps: int = 1) -> tuple[float, float, float]:
    """Return the way, velocity and acceleration along an axis of a UAV that holds a new command for some steps."""
    limits, delay = limits_of(farm, u)
    first, v, a = course(farm.velocity[u, axis], farm.acceleration[u, axis], farm.command[u, axis], limits, delay)
    then, v, a = course(v, a, command, limits, steps * farm.config.world.step_seconds - delay)
    return first + then, v, a


def stopping_way(farm: FarmState, u: int, velocity: float, acceleration: float, command: float) -> float:
    """Return the way until a UAV stands that is told to stand while it flies to an earlier command, m."""
    limits, delay = limits_of(farm, u)
    first, v, a = course(velocity, acceleration, command, limits, delay)
    return first + course(v, a, 0.0, limits, sum(time for time, _ in pieces(v, a, 0.0, *limits)))[0]


def glide(farm: FarmState, commanded: Array) -> tuple[Array, Array]:
    """Lead all UAVs towards commanded velocities [n, 2] for a step.

    Returns:
        their ways [n, 2] m, and the energy of the flight [n] J.
    """
    seconds, energy = farm.config.world.step_seconds, farm.config.energy
    wind = farm.wind[farm.time] if farm.config.wind.some else np.zeros(2)
    tops, air = (np.array(farm.config.dynamics.of_types(name))[farm.kind][:, None] for name in ("speed", "airspeed"))
    command = np.clip(commanded, -tops, tops)
    if farm.config.wind.some:
        command = np.clip(command, wind - air, wind + air)
    before, way = farm.velocity - wind, np.zeros_like(command)
    velocity, acceleration = farm.velocity.copy(), farm.acceleration.copy()
    for u, axis in np.ndindex(*command.shape):
        way[u, axis], velocity[u, axis], acceleration[u, axis] = after(farm, u, axis, float(command[u, axis]))
    farm.velocity, farm.acceleration, farm.command = velocity, acceleration, command
    change = np.linalg.norm(velocity - wind - before, axis=1) / seconds
    load = np.sqrt(1.0 + (change / energy.gravity) ** 2)
    speed = np.linalg.norm(way / seconds - wind, axis=1)
    kinetic = energy.mass / 2.0 * (((velocity - wind) ** 2).sum(axis=1) - (before**2).sum(axis=1))
    power = np.array([flight_power(energy, v, n) for v, n in zip(speed, load, strict=True)])
    return way, power * seconds + np.maximum(0.0, kinetic)


def stop(farm: FarmState, where: NDArray[np.bool_]) -> None:
    """Let UAVs stand along the axes [n, 2] where something stops them."""
    farm.velocity, farm.acceleration, farm.command = (
        np.where(where, 0.0, values) for values in (farm.velocity, farm.acceleration, farm.command)
    )


def held_places(farm: FarmState, u: int, moves: NDArray[np.float32], steps: int = HOLD) -> Array:
    """Return where a UAV is that holds each of nine velocities for some steps, in the field, [9, 2] m."""
    world = farm.config.world
    place = [
        [farm.position[u, k] + after(farm, u, k, goal[k], steps)[0] for k in range(2)]
        for goal in _goals(farm, u, moves)
    ]
    return np.asarray(np.clip(place, 0.0, (world.field_x, world.field_y)))


def _goals(farm: FarmState, u: int, moves: NDArray[np.float32]) -> Array:
    """Return the velocities of nine moves along the field's axes, [9, 2] m/s."""
    world, top = farm.config.world, farm.config.dynamics.of_types("speed")[farm.kind[u]]
    return np.asarray(moves * signs_of(farm, u) * np.minimum(top, (world.speed_x_max, world.speed_y_max)))


def motion_view(farm: FarmState, u: int, signs: Array, moves: NDArray[np.float32]) -> Array:
    """Return a UAV's acceleration, command and way to a stop, and which moves overrun."""
    world, dynamics, kind = farm.config.world, farm.config.dynamics, farm.kind[u]
    size = np.array([world.field_x, world.field_y])
    way = [stopping_way(farm, u, farm.velocity[u, k], farm.acceleration[u, k], farm.command[u, k]) for k in range(2)]
    overruns = []
    for goal in _goals(farm, u, moves):
        place = farm.position[u].copy()
        for k in range(2):
            moved, v, a = after(farm, u, k, goal[k])
            place[k] += moved + stopping_way(farm, u, v, a, goal[k])
        outside = bool(((place < -ROUNDING) | (place > size + ROUNDING)).any())
        overruns.append(outside or bool(refused(farm.position[u], place, farm.layout.zones)))
    return np.concatenate(
        [
            signs * farm.acceleration[u] / dynamics.of_types("acceleration")[kind],
            signs * farm.command[u] / (world.speed_x_max, world.speed_y_max),
            signs * way / farthest_stop(dynamics, kind),
            overruns,
        ]
    )
