"""A task that cannot be done without memory is learned with it, and only with it."""

from typing import ClassVar

import numpy as np
import pytest
from gymnasium import spaces
from pettingzoo import ParallelEnv

from eia_sec.common.config import EnvConfig, RolloutConfig, RunConfig
from eia_sec.deploy.local.in_process import train_in_process
from tests.learner.on_policy.small_runs import ALGORITHMS

STEPS = 4


class Recall(ParallelEnv):
    """Each of two agents sees one of two signals in the first step, and is asked for it in the last.

    It earns 1 if it then names its signal, so 0.5 on average by guessing.
    """

    metadata: ClassVar = {"name": "recall"}

    def __init__(self):
        self.possible_agents = ["witness_0", "witness_1"]

    def observation_space(self, agent):
        return spaces.Box(-1.0, 1.0, (2,), np.float32)

    def action_space(self, agent):
        return spaces.Discrete(2)

    def reset(self, seed=None, options=None):
        draw = np.random.default_rng(seed)
        self.agents, self.step_count = list(self.possible_agents), 0
        self.signal = {agent: int(draw.integers(2)) for agent in self.agents}
        return self._seen(), {agent: {} for agent in self.agents}

    def _seen(self):
        asked = float(self.step_count == STEPS - 1)
        shown = {agent: 2.0 * signal - 1.0 for agent, signal in self.signal.items()}
        return {agent: np.array([0.0 if self.step_count else shown[agent], asked], np.float32) for agent in self.signal}

    def step(self, actions):
        self.step_count += 1
        over, present = self.step_count == STEPS, self.agents
        rewards = {agent: float(over and actions[agent] == self.signal[agent]) for agent in present}
        self.agents = [] if over else present
        ends = dict.fromkeys(present, over)
        return self._seen(), rewards, ends, dict.fromkeys(present, False), {agent: {} for agent in present}


QUICK = {
    "hidden": 16,
    "iteration_steps": 320,
    "minibatch_steps": 160,
    "sequence_steps": 10,
    "epochs": 4,
    "reward_scale": 1.0,
    "actor_rate": 1e-2,
    "critic_rate": 1e-2,
    "entropy_start": 0.005,
    "target_kl": 0.0,
    "precision": "float32",
}


def trained(name, episodes, **options):
    """Return the mean reward of the newest episodes of a run; chunks cut episodes, and sequences cut chunks."""
    config = RunConfig(
        seed=3,
        episodes=episodes,
        env=EnvConfig(name="tests.learner.on_policy.test_memory_tasks:Recall"),
        algorithm=ALGORITHMS[name](**QUICK | options),
        rollout=RolloutConfig(environments=8, chunk_steps=10),
    )
    return float(np.mean([episode.reward for episode in train_in_process(config).recent]))


@pytest.mark.parametrize(("name", "shared_until"), [("ippo", 1.0), ("mappo", 0.0), ("eia-ppo", 0.5)])
def test_a_signal_is_remembered(name, shared_until):
    """Nineteen of twenty agents name what they saw three steps before."""
    assert trained(name, 3000, memory="gru", shared_until=shared_until) > 0.95


def test_without_memory_agents_can_only_guess():
    """Perceptrons of the same run name every second signal."""
    assert 0.3 < trained("ippo", 3000) < 0.7
