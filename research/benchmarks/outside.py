"""What a step of an environment from outside costs in this package, beside the environment itself.

Run `python -m research.benchmarks.outside`. The environments return the same dictionaries at every step, so all that
is measured is what this package does: actions by agent, the checks of what a step returns, and rows. Processor time of
this process, least of several stretches; both sides are timed in turns.
"""

import json
import sys
import time
from collections.abc import Callable
from typing import Any, ClassVar, Final

import numpy as np
from gymnasium import spaces
from pettingzoo import ParallelEnv

from eia_sec.common.config import EnvConfig
from eia_sec.rollout.envs.pettingzoo_batch import PettingZooBatch

TEAMS: Final = ((3, 18, 8), (12, 48, 8), (12, 240, 8), (50, 20, 1))
"""Agents, numbers of an observation, and environments of a batch."""
STRETCHES: Final = 9
STEPS: Final = 200


class Free(ParallelEnv):
    """An environment that computes nothing."""

    metadata: ClassVar = {"name": "free"}

    def __init__(self, agents: int, numbers: int, discrete: bool) -> None:
        """Make the dictionaries that every step returns."""
        self.possible_agents = [f"agent_{k}" for k in range(agents)]
        self._seen = spaces.Box(-np.inf, np.inf, (numbers,), np.float32)
        self._acts = spaces.Discrete(9) if discrete else spaces.Box(-1.0, 1.0, (2,), np.float32)
        drawn = np.random.default_rng(0).normal(size=(agents, numbers)).astype(np.float32)
        self._observations = dict(zip(self.possible_agents, drawn, strict=True))
        self._rewards = dict.fromkeys(self.possible_agents, 1.0)
        self._flags = dict.fromkeys(self.possible_agents, False)
        self._infos: dict[str, dict[str, Any]] = {name: {} for name in self.possible_agents}

    def observation_space(self, agent: str) -> spaces.Space[Any]:
        """Return a vector's space."""
        return self._seen

    def action_space(self, agent: str) -> spaces.Space[Any]:
        """Return nine options, or a box of two numbers."""
        return self._acts

    def reset(self, seed: int | None = None, options: Any = None) -> tuple[Any, Any]:
        """Begin an episode without an end."""
        self.agents = list(self.possible_agents)
        return self._observations, self._infos

    def step(self, actions: Any) -> tuple[Any, ...]:
        """Return what all steps return."""
        return self._observations, self._rewards, self._flags, self._flags, self._infos


def main() -> None:
    """Measure, and print the result."""
    rows = [_row(*team, discrete) for discrete in (True, False) for team in TEAMS]
    sys.stdout.write(json.dumps({"command": "python -m research.benchmarks.outside", "rows": rows}, indent=2) + "\n")


def _row(agents: int, numbers: int, environments: int, discrete: bool) -> dict[str, Any]:
    arguments = {"agents": agents, "numbers": numbers, "discrete": discrete}
    config = EnvConfig("research.benchmarks.outside:Free", json.dumps(arguments))
    batch, bare = PettingZooBatch(config, environments, boxes=False), Free(**arguments)
    for index in range(environments):
        batch.reset(index, 0, 0)
    bare.reset()
    actions = np.zeros((environments, batch.team.action_size), np.float32)
    ours, theirs = np.inf, np.inf
    for _ in range(STRETCHES):
        ours = min(ours, _seconds(lambda: batch.step(actions)) / environments)
        theirs = min(theirs, _seconds(lambda: bare.step({})))
    return {**arguments, "environments": environments, "us_an_agent_step": round(1e6 * (ours - theirs) / agents, 2)}


def _seconds(step: Callable[[], Any]) -> float:
    start = time.process_time()
    for _ in range(STEPS):
        step()
    return (time.process_time() - start) / STEPS


if __name__ == "__main__":
    main()
