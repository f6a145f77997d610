"""What the scripts that train on the farm share: their command line, their farm, and the looks at what was learnt."""

import argparse
import time
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from gymnasium.spaces import Discrete

from eia_sec.common.config.presets import preset
from eia_sec.rollout.envs.parallel_env import FarmParallelEnv, Infos, Observations
from eia_sec.rollout.evaluation import evaluate
from eia_sec.rollout.policies import Policy

Point = dict[str, float]
FARM: Final = preset("instant").farm
LOOK_SHARE: Final = 0.1
"""Least time between two looks, as a share of the time since the command."""


class FarmOfChoices(FarmParallelEnv):
    """The PettingZoo farm of the preset instant, with the discrete actions of our actors, and smaller rewards.

    Infos are empty, because TorchRL's wrapper takes none that hold a dictionary.

    Args:
        reward_scale: factor on every reward.
    """

    def __init__(self, reward_scale: float) -> None:
        super().__init__(FARM)
        self._reward_scale = reward_scale
        options = [group.options for group in self.batch.team.groups for _ in range(group.count)]
        self.action_spaces = {name: Discrete(count) for name, count in zip(self.possible_agents, options, strict=True)}

    def step(
        self, actions: Mapping[str, Any]
    ) -> tuple[Observations, dict[str, float], dict[str, bool], dict[str, bool], Infos]:
        """Let all UAVs act for one step; an action is the index of an option."""
        row = np.array([[np.float32(actions[name]) for name in self.agents]], np.float32)
        (steered,) = self.batch.team.adapt(self.batch.observation, row)
        given = {name: steered[2 * k : 2 * k + 2] for k, name in enumerate(self.agents)}
        seen, rewards, terminated, truncated, infos = super().step(given)
        scaled = {name: self._reward_scale * reward for name, reward in rewards.items()}
        return seen, scaled, terminated, truncated, infos

    def _infos(self) -> Infos:
        """Return empty infos; peers do not pay for what they do not use."""
        return {name: {} for name in self.possible_agents}


def farm_options(software: str) -> argparse.ArgumentParser:
    """Return the command line that all scripts understand."""
    parser = argparse.ArgumentParser(description=f"When {software} flies the farm well enough.")
    parser.add_argument("--algorithm", required=True)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--began", type=float, required=True, help="when the clock started, seconds since 1970")
    parser.add_argument("--limit", type=float, required=True, help="seconds of training at most")
    parser.add_argument("--every", type=float, required=True, help="least seconds of training between two looks")
    parser.add_argument("--reward", type=float, required=True, help="what is wanted, per agent")
    parser.add_argument("--farms", type=int, nargs="+", required=True, help="seeds of the farms that are looked at")
    parser.add_argument("--threads", type=int, required=True)
    parser.add_argument("--environments", type=int, required=True)
    parser.add_argument("--iteration", type=int, required=True, help="environment steps of an iteration")
    parser.add_argument("--epochs", type=int, required=True)
    parser.add_argument("--minibatch", type=int, required=True, help="environment steps in a minibatch")
    parser.add_argument("--width", type=int, required=True)
    parser.add_argument("--rate", type=float, required=True)
    parser.add_argument("--discount", type=float, required=True)
    parser.add_argument("--gae-lambda", type=float, required=True)
    parser.add_argument("--clip", type=float, required=True)
    parser.add_argument("--entropy", type=float, required=True)
    parser.add_argument("--gradient-clip", type=float, required=True)
    parser.add_argument("--reward-scale", type=float, required=True)
    return parser


def reward_of(policy: Policy, farms: Sequence[int]) -> float:
    """Return a policy's reward per agent without noise: the mean over one episode of each of some farms."""
    return evaluate(FARM, policy, farms, 1, name="policy", batch=len(farms)).total.reward


class Course:
    """The looks at a policy while it is trained; the clock stands while somebody looks.

    Attributes:
        points: seconds of training, environment steps, updates and reward at each look.

    Args:
        options: those of `farm_options`.
    """

    def __init__(self, options: argparse.Namespace) -> None:
        self._options = options
        self._next, self._paused = options.every, 0.0
        self.points: list[Point] = []

    @property
    def seconds(self) -> float:
        """Seconds of training since the process was started."""
        return time.time() - float(self._options.began) - self._paused

    def over(self, policy: Policy, steps: int, updates: int) -> bool:
        """Look when it is time to; return whether what is wanted was reached, or the time is up."""
        seconds = self.seconds
        if seconds < min(self._next, self._options.limit):
            return False
        looked = time.time()
        reward = reward_of(policy, self._options.farms)
        self._paused += time.time() - looked
        self._next = seconds + max(self._options.every, LOOK_SHARE * seconds)
        self.points.append({"seconds": round(seconds, 2), "steps": steps, "updates": updates, "reward": reward})
        return reward >= self._options.reward or seconds >= self._options.limit

    def result(self) -> dict[str, Any]:
        """Return the line that is handed over."""
        return {"points": self.points}
