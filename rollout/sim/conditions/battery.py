"""Batteries: each step takes its energy from them, stations charge them, and UAVs see their charge.

A UAV that ends a step near a station and has hardly moved in it has landed. It needs no power to fly then, and goes on
with its task. A UAV whose battery is empty fails in the next step.
"""

import math
from typing import Final

from eia_sec.common.config.farm.battery import LANDING
from eia_sec.rollout.sim.conditions.failures import see_nothing
from eia_sec.rollout.sim.core.arrays import Farm, Scratch
from eia_sec.rollout.sim.core.compile import allocation_free, inlined
from eia_sec.rollout.sim.core.constants import Constants
from eia_sec.rollout.sim.core.motion import flight_power
from eia_sec.rollout.sim.core.planes import kind_of
from eia_sec.rollout.sim.core.records import Array

STILL: Final = 1.0
"""Fastest that a UAV moves that lands, m/s."""
NUMBERS: Final = 4
"""Numbers that a UAV sees of its battery."""


@inlined
def use_charge(c: Constants, farm: Farm, s: Scratch) -> None:
    """Take the step's energy from the batteries, and charge those of UAVs that have landed.

    Updates `charge`, `failure` where a battery is empty, and `energy` of UAVs that have landed.
    """
    fleet, battery, charge, energy, step = c.fleet, c.battery, farm.charge, farm.energy, farm.time[0]
    position, previous, way, stations = farm.position, s.previous, STILL * c.fleet.seconds, c.fleet.stations
    for u in range(len(charge)):
        if farm.gone[u]:
            continue
        x, y = position[u, 0], position[u, 1]
        dx, dy = x - previous[u, 0], y - previous[u, 1]
        station = _nearest_station(stations, x, y)
        to_x, to_y = stations[station, 0] - x, stations[station, 1] - y
        charged = 0.0
        if dx * dx + dy * dy <= way * way and to_x * to_x + to_y * to_y <= LANDING * LANDING:
            energy[u] = fleet.payloads[kind_of(fleet, u)] * fleet.seconds
            charged = battery.power * fleet.seconds
        charge[u] = min(battery.capacity, charge[u] - energy[u] + charged)
        if charge[u] <= 0.0:
            farm.failure[u] = min(farm.failure[u], step + 1)


@allocation_free
def _nearest_station(stations: Array, x: float, y: float) -> int:
    """Return the station nearest to a place; of equals, the first."""
    nearest, least = 0, math.inf
    for k in range(len(stations)):
        dx, dy = stations[k, 0] - x, stations[k, 1] - y
        if dx * dx + dy * dy < least:
            nearest, least = k, dx * dx + dy * dy
    return nearest


@inlined
def put_charge(c: Constants, farm: Farm, u: int, sx: float, sy: float, at: int) -> int:
    """Write a UAV's charge, the offset to the nearest station, and what would be left there; return where they end."""
    fleet, battery, seen = c.fleet, c.battery, farm.observation
    if not battery.some:
        return see_nothing(NUMBERS, seen, at)
    x, y, share = farm.position[u, 0], farm.position[u, 1], farm.charge[u] / battery.capacity
    station = _nearest_station(fleet.stations, x, y)
    dx, dy = fleet.stations[station, 0] - x, fleet.stations[station, 1] - y
    speed = min(fleet.speed_x, fleet.speed_y)
    power = flight_power(c.flight, speed) + fleet.payloads[kind_of(fleet, u)]
    left = share - math.sqrt(dx * dx + dy * dy) / speed * power / battery.capacity
    seen[at], seen[at + 1], seen[at + 2] = max(0.0, share), sx * dx * fleet.per_width, sy * dy * fleet.per_depth
    seen[at + 3] = max(-1.0, left)
    return at + NUMBERS
