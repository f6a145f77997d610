"""Loads what a worker flies with before it connects, so that it can begin as soon as the learner has parameters.

The simulator's machine code is the same for all farms. With an empty cache it is compiled here, which takes a minute.
"""

from contextlib import closing
from dataclasses import replace

from eia_sec.common.actors import TeamActors
from eia_sec.common.config.presets import preset
from eia_sec.rollout.worker.collector import Collector


def warm_up() -> None:
    """Fly one step of one farm with fresh actors."""
    config = preset("inertial")
    config = replace(config, rollout=replace(config.rollout, environments=1, chunk_steps=1, threads=1))
    with closing(Collector(config, "warm-up", 0)) as collector:
        actors = TeamActors.initial(collector.team, config.algorithm.hidden, 0, shared=True)
        collector.collect(actors, 0.0, uniform=False)
