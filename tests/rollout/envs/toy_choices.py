"""A small PettingZoo environment whose agents choose among options, with action masks in either of two places."""

from typing import ClassVar

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv


class Doors(ParallelEnv):
    """Two walkers take one of four doors, a porter two switches, and a painter a Box; see `legal` for the masks.

    Agents earn the sum of their numbers, each less its space's start. The walkers leave after two steps, the others
    after four.

    Args:
        masks: "observation", "info" or "none".
        legal: maps an agent to its mask in the next states; all options are legal without one.
    """

    metadata: ClassVar = {"name": "doors"}

    ACTIONS: ClassVar = {
        "walker_0": spaces.Discrete(4, start=3),
        "painter_0": spaces.Box(-2.0, 4.0, (1,), np.float32),
        "walker_1": spaces.Discrete(4, start=-1),
        "porter_0": spaces.MultiDiscrete([2, 3], start=[5, 10**12]),
    }

    def __init__(self, masks="none", painter=True):
        self.possible_agents = [name for name in self.ACTIONS if painter or name != "painter_0"]
        self.masks, self.legal, self.actions, self.resets = masks, {}, [], 0

    def observation_space(self, agent):
        plain = spaces.Box(-9.0, 9.0, (2,), np.float32)
        if self.masks != "observation" or agent == "painter_0":
            return plain
        options = 5 if agent == "porter_0" else 4
        return spaces.Dict({"observation": plain, "action_mask": spaces.MultiBinary(options)})

    def action_space(self, agent):
        return self.ACTIONS[agent]

    def reset(self, seed=None, options=None):
        self.agents, self.time = list(self.possible_agents), 0
        self.resets += 1
        return self._seen(), self._infos()

    def mask(self, agent):
        options = 5 if agent == "porter_0" else 4
        return np.array(self.legal.get(agent, [1] * options), np.int8)

    def step(self, actions):
        assert all(self.action_space(name).contains(action) for name, action in actions.items())
        assert set(actions) == set(self.agents)
        self.actions.append(actions)
        self.time += 1
        rewards = {
            name: float(np.sum(action - getattr(self.ACTIONS[name], "start", 0))) for name, action in actions.items()
        }
        ends = {name: self.time >= (2 if name.startswith("walker") else 4) for name in self.agents}
        here, self.agents = self.agents, [name for name in self.agents if not ends[name]]
        never = dict.fromkeys(here, False)
        return self._seen(), rewards, ends, never, self._infos()

    def _seen(self):
        numbers = np.array([self.time, 1.0], np.float32)
        if self.masks != "observation":
            return {name: numbers for name in self.agents}
        return {
            name: numbers if name == "painter_0" else {"observation": numbers, "action_mask": self.mask(name)}
            for name in self.agents
        }

    def _infos(self):
        found = {name: {} for name in self.agents}
        if self.masks == "info":
            for name in found.keys() - {"painter_0"}:
                found[name]["action_mask"] = self.mask(name)
        return found


def flexible(continuous_actions=False):
    """Return an environment that has boxes for who asks for them, as MPE's have."""
    environment = Doors()
    if continuous_actions:
        environment.action_space = lambda agent: spaces.Box(0.0, 1.0, (5,), np.float32)
    return environment
