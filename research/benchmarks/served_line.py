"""The environment of `research.benchmarks.served`: two agents on a line, whose steps take as long as they are told.

`python -m research.benchmarks.served_line ENDPOINT COPIES PAUSE` serves it as `line`.
"""

import sys
import time
from typing import Any

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from eia_sec.remote import serve

STEPS = 25


class Line(ParallelEnv):
    """Two agents that should come to 0.

    Args:
        pause: time that a step takes, s.
    """

    metadata = {"name": "line"}  # noqa: RUF012  # as PettingZoo has it

    def __init__(self, pause: float = 0.0) -> None:
        self.possible_agents = ["agent_0", "agent_1"]
        self.agents: list[str] = []
        self._pause, self._time = pause, 0
        self._x = np.zeros((2, 12), np.float32)

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Return the space of twelve numbers."""
        return spaces.Box(-10.0, 10.0, (12,), np.float32)

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Return the choice of left, stay and right."""
        return spaces.Discrete(3)

    def reset(self, seed: int | None = None, options: Any = None) -> tuple[Any, Any]:
        """Begin an episode."""
        self._x = np.random.default_rng(seed).uniform(-1.0, 1.0, (2, 12)).astype(np.float32)
        self._time, self.agents = 0, list(self.possible_agents)
        return self._seen(), {agent: {} for agent in self.agents}

    def step(self, actions: dict[str, int]) -> tuple[Any, ...]:
        """Move, and take the time."""
        if self._pause:
            time.sleep(self._pause)
        for index, agent in enumerate(self.possible_agents):
            self._x[index, 0] += 0.1 * (actions[agent] - 1)
        self._time += 1
        here, over = list(self.agents), self._time == STEPS
        self.agents = [] if over else here
        rewards = {agent: -float(abs(self._x[index, 0])) for index, agent in enumerate(here)}
        return self._seen(), rewards, dict.fromkeys(here, False), dict.fromkeys(here, over), {a: {} for a in here}

    def _seen(self) -> dict[str, Any]:
        return {agent: self._x[index].copy() for index, agent in enumerate(self.possible_agents)}


if __name__ == "__main__":
    where, copies, pause = sys.argv[1:]
    serve([Line(float(pause)) for _ in range(int(copies))], "line", where)
