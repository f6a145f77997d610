"""Batteries on the reference farm."""

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config.farm.battery import LANDING
from eia_sec.rollout.sim.conditions.battery import STILL
from eia_sec.rollout.sim.reference.state import FarmState
from eia_sec.rollout.sim.stations import station_places

Array = NDArray[np.float64]


def nearest_station(farm: FarmState, u: int) -> Array:
    """Return the place of the station nearest to a UAV, [2] m."""
    places = station_places(farm.config)
    return np.asarray(places[np.argmin(((places - farm.position[u]) ** 2).sum(axis=1))])


def landed(farm: FarmState) -> NDArray[np.bool_]:
    """Return which UAVs have landed at a station, [n]."""
    way = np.linalg.norm(farm.position - farm.before, axis=1)
    gap = [np.linalg.norm(nearest_station(farm, u) - farm.position[u]) for u in range(len(way))]
    still = way <= STILL * farm.config.world.step_seconds
    return np.asarray(still & (np.array(gap) <= LANDING) & ~farm.gone)


def use_charge(farm: FarmState, payload: Array) -> None:
    """Take a step's energy from the batteries; `payload` [n] W is what a UAV needs that does not fly."""
    battery, seconds = farm.config.battery, farm.config.world.step_seconds
    down = landed(farm)
    farm.energy = np.where(down, payload * seconds, farm.energy)
    used = farm.charge - farm.energy + down * battery.power * seconds
    farm.charge = np.where(farm.gone, farm.charge, np.minimum(battery.capacity, used))
    farm.failure = np.where(~farm.gone & (farm.charge <= 0.0), np.minimum(farm.failure, farm.time + 1), farm.failure)


def charge_view(farm: FarmState, u: int, signs: Array) -> Array:
    """Return a UAV's charge, the offset to the nearest station and what would be left there; shares."""
    world, battery = farm.config.world, farm.config.battery
    if not battery.some:
        return np.zeros(4)
    offset = nearest_station(farm, u) - farm.position[u]
    speed = min(world.speed_x_max, world.speed_y_max)
    left = (farm.charge[u] - farm.power(u, speed) * float(np.linalg.norm(offset)) / speed) / battery.capacity
    share = max(0.0, farm.charge[u] / battery.capacity)
    return np.array([share, *(offset * signs / (world.field_x, world.field_y)), max(-1.0, left)])
