"""Environments that step as one batch, and in which every number can be predicted."""

import numpy as np
from gymnasium import spaces

from eia_sec import Vectorised


class Counters(Vectorised):
    """Two walkers and a keeper that see the seed and the step; they earn their first action number plus their index.

    The episode terminates after `last` steps, or is truncated then if `cut` says so. `wrong` breaks the contract.
    """

    made = 0
    closed = 0

    def __init__(self, environments, threads, last=3, cut=False, wrong=""):
        self.possible_agents = ["walker_0", "keeper_0", "walker_1"]
        self.count, self.threads, self.last, self.cut, self.wrong = environments, threads, last, cut, wrong
        self.time, self.start = np.zeros(environments, int), np.zeros(environments, int)
        self.actions = []
        Counters.made += 1

    def close(self):
        Counters.closed += 1

    def observation_space(self, agent):
        if self.wrong == "space":
            return spaces.Discrete(3)
        return spaces.Box(-np.inf, np.inf, (1, 2) if agent == "keeper_0" else (2,), np.float64)

    def action_space(self, agent):
        if agent == "keeper_0":
            return spaces.Discrete(3, start=1)
        return spaces.Box(np.array([0.0, -2.0]), np.array([1.0, 6.0]), dtype=np.float64)

    def reset(self, index, seed):
        self.time[index], self.start[index] = 0, seed % 7

    def observe(self):
        seen = np.stack([self.start, self.time], axis=1).astype(float)
        seen[:, 0] = {"nan": np.nan, "far": 1e8}.get(self.wrong, seen[0, 0]) if self.time.max() > 1 else seen[:, 0]
        found = {name: seen.reshape(self.count, *self.observation_space(name).shape) for name in self.possible_agents}
        return {name: part for name, part in found.items() if (name, self.wrong) != ("walker_1", "unseen")}

    def step(self, actions):
        if self.wrong == "raises":
            raise ValueError("no such gear")
        self.actions.append(actions)
        self.time += 1
        rewards = {
            name: np.ravel(action)[:: action[0].size] + index
            for index, (name, action) in enumerate((n, actions[n]) for n in self.possible_agents)
        }
        if self.wrong == "rewards":
            rewards["keeper_0"] = rewards["keeper_0"][:1]
        over = self.time >= self.last
        flags = (over & (not self.cut), over & self.cut)
        return (rewards, *flags) if self.wrong != "flags" else (rewards, [0] * self.count, flags[1])

    def numbers(self):
        return {"clock": self.time}
