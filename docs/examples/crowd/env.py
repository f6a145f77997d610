"""Agents that look for one another in a crowd: each is paid for coming closer to the one that it is told to meet."""

from typing import ClassVar

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

OWN = 2
"""Numbers of an observation about the agent itself: its place, x and y. Those of its neighbours follow."""
NEIGHBOUR = 4
"""Numbers about each neighbour: 1 where there is one, 1 where it is the one to meet, and where it is from here."""


class Meet(ParallelEnv):
    """Meet another one of `agents` walkers within 20 steps; observations have room for `room` others, in any order."""

    metadata: ClassVar = {"name": "meet"}

    def __init__(self, agents=4, room=9):
        if not 2 <= agents <= room + 1:
            raise ValueError(f"agents must be between 2 and {room + 1}, not {agents}")
        self.room = room
        self.possible_agents = [f"walker_{index}" for index in range(agents)]

    def observation_space(self, agent):
        return spaces.Box(-2.0, 2.0, (OWN + NEIGHBOUR * self.room,), np.float32)

    def action_space(self, agent):
        return spaces.Discrete(5)

    def reset(self, seed=None, options=None):
        self.random = np.random.default_rng(seed)
        self.agents, self.time = list(self.possible_agents), 0
        self.places = self.random.uniform(-1.0, 1.0, (len(self.agents), 2))
        round_trip = self.random.permutation(len(self.agents))
        self.wanted = np.empty_like(round_trip)
        self.wanted[round_trip] = np.roll(round_trip, -1)
        return self._seen(), {agent: {} for agent in self.agents}

    def step(self, actions):
        moves = np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]]) * 0.1
        self.places = np.clip(self.places + moves[[actions[agent] for agent in self.agents]], -1.0, 1.0)
        self.time += 1
        away = np.linalg.norm(self.places - self.places[self.wanted], axis=1)
        acted, over = self.agents, self.time == 20
        infos = {agent: {"met": float(far < 0.15)} for agent, far in zip(acted, away, strict=True)}
        self.agents = [] if over else acted
        rewards = {agent: -float(far) for agent, far in zip(acted, away, strict=True)}
        return self._seen(), rewards, dict.fromkeys(acted, False), dict.fromkeys(acted, over), infos

    def _seen(self):
        found = {}
        for index, agent in enumerate(self.possible_agents):
            others = self.random.permutation(np.delete(np.arange(len(self.places)), index))
            neighbours = np.zeros((self.room, NEIGHBOUR), np.float32)
            for slot, other in enumerate(others):
                neighbours[slot] = 1.0, other == self.wanted[index], *(self.places[other] - self.places[index])
            found[agent] = np.concatenate([self.places[index], neighbours.ravel()]).astype(np.float32)
        return found
