"""The episodes on which actors are evaluated: for an imitation event, and for a round of a population."""

from eia_sec.common.config import RunConfig
from eia_sec.common.seeds import derive, stream

Plan = tuple[tuple[int, ...], tuple[int, ...]]
"""Training farms and episode seeds."""


def evaluation_plan(config: RunConfig, event: int) -> Plan:
    """Return an event's training farms and episode seeds, a pure function of the run's seed and the event number."""
    return _plan(config, config.seed, "imitation", event, config.elite.farms)


def population_plan(config: RunConfig, number: int) -> Plan:
    """Return a round's training farms and episode seeds, which are the same for all members of a population."""
    return _plan(config, config.population.seed, "population", number, config.population.farms)


def _plan(config: RunConfig, seed: int, what: str, number: int, farms: int) -> Plan:
    count = min(farms, config.rollout.train_farms)
    drawn = stream(seed, what, number).choice(config.rollout.train_farms, size=count, replace=False).tolist()
    return tuple(drawn), tuple(derive(seed, what, number, farm) for farm in drawn)
