"""Compiles the kernels of an update before the learner serves requests, by a few updates of a throwaway trainer.

With an empty cache, compilation takes about ten seconds, during which the process could not answer messages.
"""

from dataclasses import replace

import numpy as np

from common.config import RunConfig
from common.team import TeamSpec
from common.transitions import TRANSITION, Chunk, Rows
from learner.algorithms import ALGORITHMS
from learner.trainer import Trainer


def warm_up(config: RunConfig, team: TeamSpec) -> None:
    """Absorb one chunk and do every kind of update once; do nothing on an accelerator.

    Args:
        config: the run.
        team: the layout of the team.
    """
    if config.learner.device != "cpu":
        return
    steps = max(256, 2 * config.algorithm.batch)
    small = replace(config.replay, capacity=steps, warmup_steps=0)
    trainer = Trainer(
        replace(config, replay=small, rollout=replace(config.rollout, environments=1, chunk_steps=1)), team
    )
    flag = np.full(steps, TRANSITION, np.uint8)
    flag[-1] = 0
    observation, action, reward = (
        np.zeros((steps, size), np.float32) for size in (team.observation_size, team.action_size, team.agents)
    )
    trainer.absorb(Chunk(Rows(observation, action, reward, flag), ()))
    trainer.train(ALGORITHMS[config.algorithm.name].actor_period(config.algorithm))
