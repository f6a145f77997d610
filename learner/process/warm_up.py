"""Compiles the kernels of an update before the learner serves requests, by a few updates of a throwaway trainer.

With an empty cache, compilation takes about ten seconds, during which the process could not answer messages.
"""

from dataclasses import replace

import numpy as np

from eia_sec.common.config import RunConfig
from eia_sec.common.team import TeamSpec
from eia_sec.common.transitions import TRANSITION, Chunk, Rows
from eia_sec.learner.off_policy.trainer import OffPolicyTrainer
from eia_sec.learner.on_policy.advantages import advantages
from eia_sec.learner.registry import off_policy


def warm_up(config: RunConfig, team: TeamSpec) -> None:
    """Do every kind of update once, off policy on a processor only; on policy, run the one kernel of its updates.

    Args:
        config: the run.
        team: the layout of the team.
    """
    if config.learns_on_policy:
        nothing = np.zeros((1, team.agents), np.float32)
        advantages(nothing, nothing, np.zeros(1, np.uint8), nothing[0], 0.0, time_limit_ends=True)
    elif config.learner.device == "cpu":
        _warm_up_off_policy(config, team)


def _warm_up_off_policy(config: RunConfig, team: TeamSpec) -> None:
    steps = max(256, 2 * config.off_policy.batch)
    small = replace(config.replay, capacity=steps, warmup_steps=0)
    trainer = OffPolicyTrainer(
        replace(config, replay=small, rollout=replace(config.rollout, environments=1, chunk_steps=1)), team
    )
    flag = np.full(steps, TRANSITION, np.uint8)
    flag[-1] = 0
    observation, action, reward = (
        np.zeros((steps, size), np.float32) for size in (team.observation_size, team.action_size, team.agents)
    )
    trainer.absorb(Chunk(Rows(observation, action, reward, flag), ()))
    trainer.train(off_policy(config.algorithm.name).actor_period(config.off_policy))
