"""A task whose environments step as one batch: `--env mytask.race:Race`."""

import numpy as np
from gymnasium import spaces

import eia_sec


class Race(eia_sec.Vectorised):
    """Two runners, each of which is told to reach its line."""

    possible_agents = ("runner_0", "runner_1")
    steps = 50

    def __init__(self, environments, threads):
        self.line, self.place = np.zeros((2, environments)), np.zeros((2, environments))

    def observation_space(self, agent):
        return spaces.Box(-2.0, 2.0, (1,), np.float32)

    def action_space(self, agent):
        return spaces.Box(-1.0, 1.0, (1,), np.float32)

    def reset(self, index, seed):
        self.line[:, index], self.place[:, index] = np.random.default_rng(seed).uniform(-1.0, 1.0, 2), 0.0

    def observe(self):
        return dict(zip(self.possible_agents, (self.line - self.place)[..., None], strict=True))

    def step(self, actions):
        for runner, name in enumerate(self.possible_agents):
            self.place[runner] = np.clip(self.place[runner] + 0.1 * actions[name][:, 0], -1.0, 1.0)
        distance = np.abs(self.line - self.place)
        arrived = (distance < 0.05).all(axis=0)
        return dict(zip(self.possible_agents, -distance, strict=True)), arrived, np.zeros_like(arrived)
