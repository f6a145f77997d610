"""Agents on a line cover landmarks: each moves left, right or not at all, and all are paid for every covered one."""

from typing import ClassVar

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv


class Cover(ParallelEnv):
    """Cover `agents` landmarks on a line of `size` places within 20 steps."""

    metadata: ClassVar = {"name": "cover"}

    def __init__(self, agents=2, size=5):
        self.size = size
        self.possible_agents = [f"walker_{index}" for index in range(agents)]

    def observation_space(self, agent):
        return spaces.Box(-1.0, 1.0, (2 * len(self.possible_agents),), np.float32)

    def action_space(self, agent):
        return spaces.Discrete(3)

    def reset(self, seed=None, options=None):
        random = np.random.default_rng(seed)
        count = len(self.possible_agents)
        self.agents, self.time = list(self.possible_agents), 0
        self.places = random.integers(self.size, size=count)
        self.landmarks = random.choice(self.size, count, replace=False)
        return self._seen(), {agent: {} for agent in self.agents}

    def step(self, actions):
        moves = np.array([actions[agent] - 1 for agent in self.agents])
        self.places = np.clip(self.places + moves, 0, self.size - 1)
        self.time += 1
        covered = len(set(self.places) & set(self.landmarks)) / len(self.landmarks)
        infos = {agent: {"covered": covered} for agent in self.agents}
        acted, over = self.agents, self.time == 20
        self.agents = [] if over else acted
        rewards = dict.fromkeys(acted, covered - 1.0)
        return self._seen(), rewards, dict.fromkeys(acted, False), dict.fromkeys(acted, over), infos

    def _seen(self):
        """Where the landmarks and the other agents are, seen from each agent."""
        found = {}
        for index, agent in enumerate(self.possible_agents):
            others = np.roll(self.places, -index)
            offsets = np.concatenate([self.landmarks, others]) - self.places[index]
            found[agent] = (offsets / self.size).astype(np.float32)
        return found
