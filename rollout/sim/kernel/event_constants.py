"""The compiled simulator's constants of an episode's events: failures, stress, empty batteries."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from common.config import FarmConfig
from common.farm import farm_team
from rollout.sim.stations import station_places
from rollout.sim.stress import shortened

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
    """Patches of stress.

    Attributes:
        some: whether there are any.
        square: square of their radius, m^2.
        growth: what the cycles of counters are divided by.
        plot_cycle: cycle of VDF in a patch, steps.
    """

    some: bool
    square: float
    growth: int
    plot_cycle: int


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
    """Derive the numbers of the patches of stress."""
    stress, cycle = config.stress, round(config.world.vdf_cycle / config.world.step_seconds)
    return StressConstants(stress.some, stress.radius**2, stress.growth, int(shortened(config, np.array(cycle))))


def battery_constants(config: FarmConfig) -> BatteryConstants:
    """Derive the numbers of the batteries."""
    battery = config.battery
    return BatteryConstants(battery.some, battery.capacity, battery.power, battery.landing**2, station_places(config))
