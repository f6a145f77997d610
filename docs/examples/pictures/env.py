"""Agents that see a picture: each goes to a light on a field, and is paid for coming closer."""

from typing import ClassVar

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv


class Lights(ParallelEnv):
    """Reach a light within 20 steps; each of `agents` walkers sees a picture of the field, and has a light of its own.

    Channels of a picture: the walker, its light, and the other walkers.
    """

    metadata: ClassVar = {"name": "lights"}

    def __init__(self, agents=2, size=6):
        self.size = size
        self.possible_agents = [f"walker_{index}" for index in range(agents)]

    def observation_space(self, agent):
        return spaces.Box(0, 255, (self.size, self.size, 3), np.uint8)

    def action_space(self, agent):
        return spaces.Discrete(5)

    def reset(self, seed=None, options=None):
        random = np.random.default_rng(seed)
        self.agents, self.time = list(self.possible_agents), 0
        self.places, self.lights = random.integers(self.size, size=(2, len(self.agents), 2))
        return self._seen(), {agent: {} for agent in self.agents}

    def step(self, actions):
        moves = np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
        self.places = np.clip(self.places + moves[[actions[agent] for agent in self.agents]], 0, self.size - 1)
        self.time += 1
        away = np.abs(self.places - self.lights).sum(axis=1)
        acted, over = self.agents, self.time == 20
        infos = {agent: {"there": float(far == 0)} for agent, far in zip(acted, away, strict=True)}
        self.agents = [] if over else acted
        rewards = {agent: -float(far) / self.size for agent, far in zip(acted, away, strict=True)}
        return self._seen(), rewards, dict.fromkeys(acted, False), dict.fromkeys(acted, over), infos

    def _seen(self):
        found = {}
        for index, agent in enumerate(self.possible_agents):
            picture = np.zeros((self.size, self.size, 3), np.uint8)
            picture[(*self.places[index], 0)] = picture[(*self.lights[index], 1)] = 255
            for other in np.delete(self.places, index, axis=0):
                picture[(*other, 2)] = 255
            found[agent] = picture
        return found
