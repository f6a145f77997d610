"""A small PettingZoo environment in which every number can be predicted."""

from typing import ClassVar

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv


class Relay(ParallelEnv):
    """Two runners and a keeper; an agent earns its first action number plus its own index.

    The runners leave after `leave` steps, the keeper after `stay`; whoever leaves terminates, unless `cut` says that
    the keeper is truncated.
    """

    metadata: ClassVar = {"name": "relay"}

    opened = 0
    closed = 0

    def __init__(self, leave=3, stay=5, cut=False, odd=False):
        self.possible_agents = ["runner_0", "keeper_0", "runner_1"]
        self.leave, self.stay, self.cut, self.odd = leave, stay, cut, odd
        self.actions = []
        Relay.opened += 1

    def close(self):
        Relay.closed += 1

    def observation_space(self, agent):
        if agent == "keeper_0":
            return spaces.Dict({"mode": spaces.Discrete(3), "place": spaces.Box(-9, 9, (1,), np.float64)})
        wide = self.odd and agent == "runner_1"
        return spaces.Box(-np.inf, np.inf, (3 if wide else 2,), np.float64)

    def action_space(self, agent):
        return spaces.Box(np.array([0.0, -2.0]), np.array([1.0, 6.0]), dtype=np.float64)

    def reset(self, seed=None, options=None):
        self.agents = list(self.possible_agents)
        self.step_count, self.start = 0, seed % 7
        return self._seen(), {agent: {} for agent in self.agents}

    def _seen(self):
        seen = {}
        for agent in self.agents:
            if agent == "keeper_0":
                seen[agent] = {"mode": self.step_count % 3, "place": np.array([float(self.step_count)])}
            else:
                width = self.observation_space(agent).shape[0]
                seen[agent] = np.array([self.start, *[self.step_count] * (width - 1)], np.float64)
        return seen

    def step(self, actions):
        assert set(actions) == set(self.agents)
        self.actions.append({name: action.copy() for name, action in actions.items()})
        self.step_count += 1
        present = self.agents
        rewards = {a: float(actions[a][0]) + self.possible_agents.index(a) for a in present}
        ends = {a: self.step_count >= (self.stay if a == "keeper_0" else self.leave) for a in present}
        truncated = {a: ends[a] and self.cut and a == "keeper_0" for a in present}
        terminated = {a: ends[a] and not truncated[a] for a in present}
        seen = self._seen()
        self.agents = [a for a in present if not ends[a]]
        return seen, rewards, terminated, truncated, {a: {} for a in present}


class Whole:
    """Not an environment."""


def shy(**keywords):
    """Return an environment only when asked for continuous actions."""
    environment = Relay()
    if not keywords.get("continuous_actions"):
        environment.action_space = lambda agent: spaces.Discrete(3)
    return environment


def shouting():
    """Return an environment whose agents act with words."""
    environment = Relay()
    environment.action_space = lambda agent: spaces.Text(5)
    return environment


def broken():
    """Raise an unexpected error."""
    raise RuntimeError("no licence")


def wide():
    """Return an environment whose boxes are as wide as numbers go."""
    environment = Relay()
    most = np.finfo(np.float32).max
    environment.action_space = lambda agent: spaces.Box(-most, most, (1,), np.float32)
    return environment


def numbered():
    """Return an environment whose agents are called 0 and 1."""
    environment = Relay()
    environment.possible_agents = ["0", "1"]
    environment.observation_space = lambda agent: spaces.Box(-1.0, 1.0, (2,), np.float32)
    return environment


class Lingering(Relay):
    """An environment that goes on to return numbers of agents that have left."""

    def step(self, actions):
        seen, rewards, terminated, truncated, infos = super().step(actions)
        left = [name for name in self.possible_agents if name not in seen]
        some = self.observation_space("runner_0").shape[0]
        return (
            {**seen, **{name: np.full(some, 5.0) for name in left}},
            {name: 7.0 for name in left} | rewards,
            *(
                terminated,
                truncated,
                infos,
            ),
        )


class Standing(Relay):
    """An environment that never removes an agent from its list."""

    def step(self, actions):
        found = super().step(actions)
        self.agents = list(self.possible_agents)
        return found


class Nobody(Relay):
    """An environment that does not say who its agents may be."""

    def __init__(self):
        super().__init__()
        del self.possible_agents


class Wandering(Relay):
    """An environment whose observations leave their space."""

    def _seen(self):
        seen = super()._seen()
        if "keeper_0" in seen and self.step_count == 2:
            seen["keeper_0"]["mode"] = 3
        return seen
