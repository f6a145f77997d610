"""The compiled simulator's constants of what happens during an episode: UAVs that fail, patches of stress."""

from typing import NamedTuple

from common.config import FarmConfig
from common.farm import farm_team


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


def failure_constants(config: FarmConfig) -> FailureConstants:
    """Derive the numbers of UAVs that fail."""
    relays, monitors, collectors = (group.observation_size for group in farm_team(config).groups)
    return FailureConstants(some=config.failures.some, sizes=(relays, monitors, collectors))


def stress_constants(config: FarmConfig) -> StressConstants:
    """Derive the numbers of the patches of stress."""
    stress, cycle = config.stress, round(config.world.vdf_cycle / config.world.step_seconds)
    return StressConstants(stress.some, stress.radius**2, stress.growth, max(1, cycle // stress.growth))
