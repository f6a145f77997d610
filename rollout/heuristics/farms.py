"""Farms as their configuration wants them: alone, with autopilots, or with a heuristic's advice."""

from eia_sec.common.config import FarmConfig
from eia_sec.rollout.sim.batch import FarmBatch


def make_farms(config: FarmConfig, environments: int, threads: int = 1, hindsight: bool = False) -> FarmBatch:
    """Return farms with all that their configuration asks for; the arguments and errors are those of `FarmBatch`.

    Raises:
        ConfigError: there is no such heuristic to advise, or it has no goals.
    """
    if config.observation.advice:
        from eia_sec.rollout.heuristics.advised import AdvisedFarms  # noqa: PLC0415  (loads scipy, which plain farms do without)

        return AdvisedFarms(config, environments, threads, hindsight)
    if config.battery.watched:
        from eia_sec.rollout.heuristics.failsafe import FailsafeFarms  # noqa: PLC0415  (loads scipy, too)

        return FailsafeFarms(config, environments, threads, hindsight)
    return FarmBatch(config, environments, threads, hindsight)
