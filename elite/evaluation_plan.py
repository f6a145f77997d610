"""The episodes on which an imitation event evaluates the actors."""

from eia_sec.common.config import RunConfig
from eia_sec.common.seeds import derive, stream


def evaluation_plan(config: RunConfig, event: int) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Return an event's training farms and episode seeds, a pure function of the run's seed and the event number."""
    generator = stream(config.seed, "imitation", event)
    count = min(config.elite.farms, config.rollout.train_farms)
    farms = generator.choice(config.rollout.train_farms, size=count, replace=False).tolist()
    return tuple(farms), tuple(derive(config.seed, "imitation", event, farm) for farm in farms)
