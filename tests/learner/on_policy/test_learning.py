"""Algorithms on policy learn trivial tasks, in a run inside one process."""

from typing import ClassVar

import numpy as np
import pytest
from gymnasium import spaces
from pettingzoo import ParallelEnv

from eia_sec.common.config import EnvConfig, RolloutConfig, RunConfig
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.common.transitions import TRANSITION, Chunk, Rows
from eia_sec.deploy.local.in_process import train_in_process
from eia_sec.learner.on_policy.trainer import OnPolicyTrainer
from tests.learner.on_policy.small_runs import ALGORITHMS, sampled

STEPS, OPTIONS = 10, 3


class Echo(ParallelEnv):
    """Each of two agents sees one of three signals, to which it should move; it is paid 1 less its distance.

    With `late` the pay of all steps comes at the episode's end.
    """

    metadata: ClassVar = {"name": "echo"}

    def __init__(self, late=False):
        self.possible_agents = ["reader_0", "reader_1"]
        self.late = late

    def observation_space(self, agent):
        return spaces.Box(-1.0, 1.0, (OPTIONS,), np.float32)

    def action_space(self, agent):
        return spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, seed=None, options=None):
        self.agents, self.random = list(self.possible_agents), np.random.default_rng(seed)
        self.step_count, self.earned = 0, dict.fromkeys(self.agents, 0.0)
        return self._seen(), {agent: {} for agent in self.agents}

    def _seen(self):
        self.signal = {agent: int(self.random.integers(OPTIONS)) for agent in self.agents}
        return {agent: np.eye(OPTIONS, dtype=np.float32)[signal] for agent, signal in self.signal.items()}

    def _pay(self, agent, action):
        return 1.0 - abs(float(action[0]) - (self.signal[agent] - 1) * 0.5)

    def step(self, actions):
        self.step_count += 1
        present, over = self.agents, self.step_count >= STEPS
        rewards = {agent: self._pay(agent, actions[agent]) for agent in present}
        if self.late:
            self.earned = {agent: self.earned[agent] + rewards[agent] for agent in present}
            rewards = self.earned if over else dict.fromkeys(present, 0.0)
        seen = self._seen()
        ends = dict.fromkeys(present, over)
        self.agents = [] if over else present
        return seen, rewards, dict.fromkeys(present, False), ends, {agent: {} for agent in present}


def late():
    """Return the task whose pay comes late."""
    return Echo(late=True)


QUICK = {
    "hidden": 16,
    "iteration_steps": 320,
    "minibatch_steps": 80,
    "epochs": 6,
    "discount": 0.9,
    "reward_scale": 1.0,
    "actor_rate": 1e-2,
    "critic_rate": 1e-2,
    "entropy_start": 0.005,
    "target_kl": 0.0,
}


@pytest.mark.parametrize(
    ("name", "task", "episodes", "wanted"),
    [
        ("ippo", "Echo", 1200, 8.0),
        ("mappo", "Echo", 1200, 8.0),
        ("eia-ppo", "Echo", 1200, 8.0),
        ("ippo", "late", 2000, 7.0),
    ],
)
def test_a_trivial_task_is_learned(name, task, episodes, wanted):
    """The mean reward of an episode's agents rises from that of chance to nearly the greatest, which is 10."""
    config = RunConfig(
        seed=3,
        episodes=episodes,
        env=EnvConfig(name=f"tests.learner.on_policy.test_learning:{task}"),
        algorithm=ALGORITHMS[name](**QUICK),
        rollout=RolloutConfig(environments=8, chunk_steps=20),
    )
    first: list[float] = []

    def note(trainer, chunk):
        first.extend([float(np.mean(episode.reward)) for episode in chunk.episodes] if trainer.iterations == 0 else [])

    trainer = train_in_process(config, note)
    assert 0.0 < np.mean(first) < 6.0
    assert np.mean([episode.reward for episode in trainer.recent]) > wanted


def named(trainer, draw):
    """Return a chunk in which agents name what they see, one of their legal options, for a reward of 1."""
    team, steps = trainer.team, 320
    observation = np.zeros((steps + 1, team.agents, 2 * OPTIONS), np.float32)
    signal = draw.integers(OPTIONS, size=(steps + 1, team.agents))
    np.put_along_axis(observation[..., :OPTIONS], signal[..., None], 1.0, axis=-1)
    observation[..., OPTIONS:] = 1.0
    np.put_along_axis(observation[..., OPTIONS:], ((signal + 1) % OPTIONS)[..., None], 0.0, axis=-1)
    rows = observation.reshape(steps + 1, -1)
    action, log_probability = sampled(trainer.actors(), rows, draw)
    reward = (action == signal).astype(np.float32)
    flag = np.full(steps + 1, TRANSITION, np.uint8)
    flag[-1] = 0
    for array in (action, log_probability, reward):
        array[-1] = 0.0
    return Chunk(Rows(rows, action, reward, flag, log_probability)), float(reward[:-1].mean())


def test_discrete_actions_with_masks_are_learned():
    """Agents that choose among two legal options of three come from a half to nineteen of twenty right."""
    team = TeamSpec((GroupSpec("reader", 2, 2 * OPTIONS, 1, choices=(OPTIONS,), masked=True),))
    trainer = OnPolicyTrainer(RunConfig(seed=3, episodes=10, algorithm=ALGORITHMS["ippo"](**QUICK)), team)
    draw, right = np.random.default_rng(0), []
    for _ in range(40):
        chunk, share = named(trainer, draw)
        right.append(share)
        trainer.absorb(chunk)
        trainer.train(trainer.updates_due())
    assert 0.4 < right[0] < 0.6
    assert max(right) > 0.95  # not for ever: where all are right, advantages are noise, and this learning rate is large
