"""Flight: speed, energy, the field's border and nearby UAVs."""

import math

import numpy as np

from eia_sec.rollout.sim.conditions.wind import ground_speed
from eia_sec.rollout.sim.conditions.zones import refused
from eia_sec.rollout.sim.core.arrays import Farm, Scratch
from eia_sec.rollout.sim.core.compile import allocation_free, inlined
from eia_sec.rollout.sim.core.constants import Constants, FleetConstants, FlightConstants
from eia_sec.rollout.sim.core.dynamics import ACCELERATION, COMMAND, VELOCITY, follow
from eia_sec.rollout.sim.core.planes import height_of, kind_of
from eia_sec.rollout.sim.core.records import Array, Float32, Indices


@allocation_free
def flight_power(flight: FlightConstants, speed: float, load: float = 1.0) -> float:
    """Return P_fly(|v|), W, as printed (W5).

    The load is the thrust over the weight m g, which it replaces; it exceeds 1 where a UAV accelerates.
    """
    if speed < flight.hover_speed:
        return load * math.sqrt(load) * flight.hover
    return flight.c1 * speed * speed + load * load * flight.c2 / speed + load * flight.weight * speed


@allocation_free
def flight_energy(
    flight: FlightConstants,
    seconds: float,
    before_x: float,
    before_y: float,
    after_x: float,
    after_y: float,
    way_x: float,
    way_y: float,
) -> float:
    """Return the energy of a step in which the velocity changes, J.

    It is the power at the mean speed with the thrust of the mean acceleration, and what kinetic energy is gained; none
    is won back.

    Args:
        flight: constants.
        seconds: of the step.
        before_x: airspeed along x before the step, m/s.
        before_y: the same along y.
        after_x: the same after the step.
        after_y: the same along y.
        way_x: way through the air, m.
        way_y: the same along y.
    """
    change = math.hypot(after_x - before_x, after_y - before_y) / (seconds * flight.gravity)
    power = flight_power(flight, math.hypot(way_x, way_y) / seconds, math.sqrt(1.0 + change * change))
    gained = after_x * after_x + after_y * after_y - before_x * before_x - before_y * before_y
    return power * seconds + 0.5 * flight.mass * max(0.0, gained)


@allocation_free
def _stop(motion: Array, axis: int) -> None:
    """Let a UAV stand along an axis: nothing leads it on where a border or a zone stops it."""
    motion[VELOCITY + axis], motion[ACCELERATION + axis], motion[COMMAND + axis] = 0.0, 0.0, 0.0


@inlined
def _glide(c: Constants, farm: Farm, u: int, vx: float, vy: float) -> tuple[float, float]:
    """Lead a UAV towards a commanded velocity for a step; return its way along both axes, m.

    Updates `motion`, and writes `energy` of the flight.
    """
    fleet, d, motion, kind = c.fleet, c.dynamics, farm.motion[u], kind_of(c.fleet, u)
    vx, vy = min(d.speed[kind], max(-d.speed[kind], vx)), min(d.speed[kind], max(-d.speed[kind], vy))
    wind_x, wind_y = 0.0, 0.0
    if fleet.wind:
        wind_x, wind_y = farm.wind[farm.time[0], 0], farm.wind[farm.time[0], 1]
        vx, vy = ground_speed(vx, wind_x, d.airspeed[kind]), ground_speed(vy, wind_y, d.airspeed[kind])
    before_x, before_y = motion[VELOCITY], motion[VELOCITY + 1]
    x, motion[VELOCITY], motion[ACCELERATION] = follow(d, kind, motion, 0, vx, fleet.seconds)
    y, motion[VELOCITY + 1], motion[ACCELERATION + 1] = follow(d, kind, motion, 1, vy, fleet.seconds)
    motion[COMMAND], motion[COMMAND + 1] = vx, vy
    farm.energy[u] = flight_energy(
        c.flight,
        fleet.seconds,
        before_x - wind_x,
        before_y - wind_y,
        motion[VELOCITY] - wind_x,
        motion[VELOCITY + 1] - wind_y,
        x - wind_x * fleet.seconds,
        y - wind_y * fleet.seconds,
    )
    return x, y


@inlined
def fly(c: Constants, farm: Farm, s: Scratch, action: Float32) -> None:
    """Fly one step with the commanded velocity over ground v = action * (V_x-max, V_y-max).

    Reads the directions observed before the step. Updates `position`, clipped to the field (W11). Writes `energy` for
    the commanded velocity (W6, W7), in wind for the airspeed that it takes; with inertia, for the flight that follows
    from it. Writes to the scratch `previous`, `outside` (ACT) and `motivated`, which is 1 where v . D > 0 (W25). A UAV
    that is gone does not move, and uses no energy.

    Args:
        c: constants.
        farm: the environment.
        s: scratch.
        action: [2 n] commanded velocities as fractions of the top speed; clipped to [-1, 1].
    """
    fleet, flight, position, direction, energy = c.fleet, c.flight, farm.position, farm.direction, farm.energy
    previous, outside, motivated = s.previous, s.outside, s.motivated
    for u in range(len(position)):
        if farm.gone[u]:
            energy[u], motivated[u], outside[u] = 0.0, 0.0, 0.0
            continue
        vx = min(1.0, max(-1.0, np.float64(action[2 * u]))) * fleet.speed_x
        vy = min(1.0, max(-1.0, np.float64(action[2 * u + 1]))) * fleet.speed_y
        motivated[u] = 1.0 if vx * direction[u, 0] + vy * direction[u, 1] > 0.0 else 0.0
        if c.dynamics.some:
            way_x, way_y = _glide(c, farm, u, vx, vy)
            energy[u] += fleet.payloads[kind_of(fleet, u)] * fleet.seconds
        else:
            air_x, air_y = vx, vy
            if c.fleet.wind:
                wind_x, wind_y = farm.wind[farm.time[0], 0], farm.wind[farm.time[0], 1]
                vx, vy = ground_speed(vx, wind_x, fleet.speed_x), ground_speed(vy, wind_y, fleet.speed_y)
                air_x, air_y = vx - wind_x, vy - wind_y
            speed = math.sqrt(air_x * air_x + air_y * air_y)
            energy[u] = (flight_power(flight, speed) + fleet.payloads[kind_of(fleet, u)]) * fleet.seconds
            way_x, way_y = vx * fleet.seconds, vy * fleet.seconds
        previous[u, 0], previous[u, 1] = position[u, 0], position[u, 1]
        x = position[u, 0] + way_x
        y = position[u, 1] + way_y
        position[u, 0] = min(fleet.width, max(0.0, x))
        position[u, 1] = min(fleet.depth, max(0.0, y))
        outside[u] = 1.0 if position[u, 0] != x or position[u, 1] != y else 0.0
        if c.dynamics.some and position[u, 0] != x:
            _stop(farm.motion[u], 0)
        if c.dynamics.some and position[u, 1] != y:
            _stop(farm.motion[u], 1)
        if c.fleet.zones:
            x, y = previous[u, 0], previous[u, 1]
            if refused(c.fleet.zone_first, farm.zone_side, farm.zone_box, x, y, position[u, 0], position[u, 1]):
                position[u, 0], position[u, 1], outside[u] = x, y, 1.0
                if c.dynamics.some:
                    _stop(farm.motion[u], 0)
                    _stop(farm.motion[u], 1)


@allocation_free
def separation(fleet: FleetConstants, position: Array, a: int, b: int) -> float:
    """Return the 3-D distance between two UAVs, m."""
    dx, dy = position[a, 0] - position[b, 0], position[a, 1] - position[b, 1]
    dz = height_of(fleet, a) - height_of(fleet, b)
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@inlined
def find_nearest(c: Constants, farm: Farm, s: Scratch) -> None:
    """Find each UAV's closest UAV in the same plane, UAV_N (W10).

    Writes to the scratch `neighbour`, `distance` and `apart_square`, `crowded`, and `x` and `y` (the positions along
    each axis). Ties go to the lowest index.
    """
    fleet, position, x, y, peer, apart_square = c.fleet, farm.position, s.x, s.y, s.peer, s.apart_square
    neighbour, distance, crowded = s.neighbour, s.distance, s.crowded
    for u in range(len(position)):
        x[u], y[u], peer[u], apart_square[u] = position[u, 0], position[u, 1], -1, math.inf
    borders = 0, fleet.relays, fleet.collectors, fleet.uavs
    for kind in range(3):
        first, last = borders[kind], borders[kind + 1]
        _find_peers(first, x[first:last], y[first:last], peer[first:last], apart_square[first:last])
    for u in range(len(position)):
        neighbour[u], distance[u] = peer[u], math.sqrt(apart_square[u])
        crowded[u] = 1.0 if distance[u] < fleet.collision else 0.0


@allocation_free
def _find_peers(first: int, x: Array, y: Array, peer: Indices, apart_square: Array) -> None:
    """Find the nearest neighbours within one plane whose first UAV is given, several at once."""
    for u in range(len(x)):
        own_x, own_y = x[u], y[u]
        for other in range(len(x)):
            dx, dy = own_x - x[other], own_y - y[other]
            square = dx * dx + dy * dy
            less = (square < apart_square[other]) & (other != u)
            apart_square[other] = square if less else apart_square[other]
            peer[other] = first + u if less else peer[other]


@allocation_free
def safety_risk(fleet: FleetConstants, previous: Array, neighbour: Indices, distance: Array, u: int) -> float:
    """Return SR of a UAV, max(0, d(t - t_step) - d(t)) of the pair that is closest now, m (W8).

    It is 0 if the pair is d_safety or more apart, or if there is no other UAV.
    """
    if neighbour[u] < 0 or distance[u] >= fleet.safety:
        return 0.0
    closer: float = separation(fleet, previous, u, neighbour[u]) - distance[u]
    return max(0.0, closer)
