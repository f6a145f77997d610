"""Farms as their configuration wants them: alone or with autopilots."""

from eia_sec.common.config import FarmConfig
from eia_sec.rollout.sim.batch import FarmBatch


def make_farms(config: FarmConfig, environments: int, threads: int = 1, hindsight: bool = False) -> FarmBatch:
    """Return farms with all that their configuration asks for; the arguments and errors are those of `FarmBatch`."""
    if config.battery.watched:
        from eia_sec.rollout.heuristics.failsafe import FailsafeFarms  # noqa: PLC0415  (loads scipy, which plain farms do without)

        return FailsafeFarms(config, environments, threads, hindsight)
    return FarmBatch(config, environments, threads, hindsight)
