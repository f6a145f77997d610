"""The compiled simulator's constants of an episode's events: failures, stress, empty batteries."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.farm import farm_team
from eia_sec.rollout.sim.stations import station_places

Array = NDArray[np.float64]


class FailureConstants(NamedTuple):
    """UAVs that fail.

    Attributes:
        some: whether any UAV can fail.
        sizes: numbers that a UAV of each type observes.
    """

    some: bool
    sizes: tuple[int, int, int]


class StressConstants(NamedTuple):
    """Patches and areas of stress.

    Attributes:
        some: whether there are any.
        square: square of the patches' radius, m^2.
        growth: what a patch divides the cycles of counters by.
    """

    some: bool
    square: float
    growth: int


class BatteryConstants(NamedTuple):
    """Batteries.

    Attributes:
        some: whether UAVs have any.
        capacity: of each, J.
        power: of charging, W.
        landing_square: square of the distance from a station within which UAVs land, m^2.
        stations: [K, 2] m.
    """

    some: bool
    capacity: float
    power: float
    landing_square: float
    stations: Array


def failure_constants(config: FarmConfig) -> FailureConstants:
    """Derive the numbers of UAVs that fail."""
    relays, monitors, collectors = (group.observation_size for group in farm_team(config).groups)
    return FailureConstants(some=config.loses_uavs, sizes=(relays, monitors, collectors))


def stress_constants(config: FarmConfig) -> StressConstants:
    """Derive the numbers of the patches and areas of stress."""
    stress = config.stress
    return StressConstants(stress.some, stress.radius**2, stress.growth)


def battery_constants(config: FarmConfig) -> BatteryConstants:
    """Derive the numbers of the batteries."""
    battery = config.battery
    return BatteryConstants(battery.some, battery.capacity, battery.power, battery.landing**2, station_places(config))
