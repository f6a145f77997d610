"""Noise-free evaluation of a policy on farms or on scenarios of another environment."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from eia_sec.common.config import FarmConfig, RunConfig
from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.errors import ConfigError
from eia_sec.common.seeds import derive
from eia_sec.common.team import TeamSpec
from eia_sec.common.transitions import EpisodeSummary
from eia_sec.rollout.envs.base import Environments, Reach
from eia_sec.rollout.envs.registry import make_environments, patient_with
from eia_sec.rollout.heuristics.farms import make_farms
from eia_sec.rollout.policies import BatchPolicy, Policy
from eia_sec.rollout.sim.batch import FarmBatch

BATCH: Final = 32
"""Episodes in one batch; results do not depend on it."""

World = TypeVar("World", bound=Environments)


@dataclass(frozen=True)
class Score:
    """Means over episodes.

    Attributes:
        reward: sum of an episode's rewards, mean over all agents.
        types: the same over the agents of each type, by the type's name.
        steps: steps of an episode.
        metrics: the episode metrics of the environment, by name.
        infos: means of the numbers in a PettingZoo environment's infos, over the episodes that have them.
    """

    reward: float
    types: Mapping[str, float]
    steps: float
    metrics: Mapping[str, float]
    infos: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Evaluation:
    """Scores of a policy on a set of farms, or of scenarios of another environment.

    Attributes:
        policy: name of the policy.
        farms: seeds of the farms.
        episodes: episodes on each farm.
        total: means over all farms.
        per_farm: means over the episodes of each farm, in the order of `farms`.
        environment: names and labels of the types of agents and the episode metrics.
    """

    policy: str
    farms: tuple[int, ...]
    episodes: int
    total: Score
    per_farm: tuple[Score, ...]
    environment: EnvironmentSpec

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the mean reward per agent and episode, by Student's t over the farms; endless for one."""
        rewards = np.array([score.reward for score in self.per_farm])
        if len(rewards) < 2:
            return -math.inf, math.inf
        half = float(stdtrit(len(rewards) - 1, 0.975) * rewards.std(ddof=1) / math.sqrt(len(rewards)))
        return self.total.reward - half, self.total.reward + half

    def to_dict(self) -> dict[str, Any]:
        """Return the evaluation as `eia-sec evaluate --json` prints it; types by their short names."""
        total = self.total
        return {
            "policy": self.policy,
            "farms": list(self.farms),
            "episodes": self.episodes,
            "reward": {"mean": total.reward, **self._types(total)},
            "steps": total.steps,
            **total.metrics,
            **({"infos": dict(total.infos)} if total.infos else {}),
            "per_farm": [
                {"farm": farm, "reward": score.reward, **self._types(score), "steps": score.steps, **score.metrics}
                for farm, score in zip(self.farms, self.per_farm, strict=True)
            ],
        }

    def _types(self, score: Score) -> dict[str, float]:
        return {self.environment.short_names.get(name, name): value for name, value in score.types.items()}


@dataclass(frozen=True)
class Trajectory:
    """The data of one episode for a picture.

    Attributes:
        config: the farm.
        farm: the farm's seed.
        episode: the episode's number.
        position: [T + 1, n, 2] m; row order of the team.
        assignment: [n_m + n_d] relay of each served UAV at the end.
        sensor_xy: [S, 2] m.
        sensor_type: [S] index of the sensor's type.
        aoi: [T + 1] mean over the sensors, units.
        vdf: [T + 1] mean over the plots, units.
        collected: [T + 1, n] cumulative VMUF or DCUF of each UAV, units; 0 for relays.
        final_aoi: [S] units.
        final_vdf: [n_px, n_py] units.
        summary: summary of the episode.
    """

    config: FarmConfig
    farm: int
    episode: int
    position: NDArray[np.float64]
    assignment: NDArray[np.int64]
    sensor_xy: NDArray[np.float64]
    sensor_type: NDArray[np.int64]
    aoi: NDArray[np.float64]
    vdf: NDArray[np.float64]
    collected: NDArray[np.float64]
    final_aoi: NDArray[np.float64]
    final_vdf: NDArray[np.float64]
    summary: EpisodeSummary


def evaluate_environments(
    make: Callable[[int], World],
    policy: BatchPolicy[World],
    farms: Sequence[int],
    episodes: int,
    *,
    name: str,
    batch: int = BATCH,
    tell: Callable[[float], None] = lambda share: None,
) -> Evaluation:
    """Evaluate a policy on farms, or on scenarios of another environment.

    Args:
        make: makes the given number of environments.
        policy: the policy.
        farms: seeds of the farms.
        episodes: episodes on each farm; number k has the seed `episode_seed(farm, k)`.
        name: the policy's name in the result.
        batch: episodes in one batch; results do not depend on it.
        tell: called after each step with the share of the work that is done, 0 to 1, if episodes last their longest.

    Raises:
        ConfigError: there is no farm or no episode to fly.
        PolicyError: the policy does not fit the farm.
    """
    if not farms or episodes < 1 or batch < 1:
        raise ConfigError("an evaluation needs at least one farm, one episode and a batch of one.")
    jobs = [(farm, episode) for farm in farms for episode in range(episodes)]
    scores: list[Score] = []
    for first in range(0, len(jobs), batch):
        part = jobs[first : first + batch]
        with closing(make(len(part))) as flown:
            _begin(flown, policy, part)
            longest, step = flown.spec.episode_steps[1], 0
            while not flown.ended.all():
                flown.step(policy.act(flown))
                step += 1
                tell((first + len(part) * min(1.0, step / longest)) / len(jobs))
            environment = flown.spec
            scores += [_score(flown.team, flown.summary(index)) for index in range(len(part))]
    per_farm = [_mean(scores[first : first + episodes]) for first in range(0, len(jobs), episodes)]
    return Evaluation(name, tuple(farms), episodes, _mean(per_farm), tuple(per_farm), environment)


def evaluate(
    config: FarmConfig, policy: Policy, farms: Sequence[int], episodes: int, *, name: str, batch: int = BATCH
) -> Evaluation:
    """Evaluate a policy on farms of a configuration; see `evaluate_environments`."""
    return evaluate_environments(
        lambda count: make_farms(config, count), policy, farms, episodes, name=name, batch=batch
    )


def evaluate_run(
    config: RunConfig,
    policy: BatchPolicy[Environments],
    farms: Sequence[int],
    episodes: int,
    *,
    name: str,
    reach: Reach | None = None,
    tell: Callable[[float], None] = lambda share: None,
) -> Evaluation:
    """Evaluate a policy in the environment of a run; see `evaluate_environments`.

    With `reach`, which environments need that others serve, episodes run in the copies of one of them.
    """
    batch = BATCH
    if config.env.served and reach is not None:
        from eia_sec.rollout.remote.served import copies_of  # noqa: PLC0415  (pettingzoo loads only for its users)

        batch = min(BATCH, copies_of(reach, config.env.served))

    def make(count: int) -> Environments:
        return make_environments(config, count, reach=reach)

    with patient_with(config):
        return evaluate_environments(make, policy, farms, episodes, name=name, batch=batch, tell=tell)


def record(
    config: FarmConfig, policy: Policy, farm: int, episode: int, tell: Callable[[float], None] = lambda share: None
) -> Trajectory:
    """Record one episode step by step; it is the episode that `evaluate` runs. `tell` hears the share that is done.

    Raises:
        PolicyError: the policy does not fit the farm.
    """
    flown = _begin(make_farms(config, 1), policy, [(farm, episode)])
    layout = flown.layout(0)
    course = [_snapshot(flown)]
    for step in range(config.world.steps):
        flown.step(policy.act(flown))
        course.append(_snapshot(flown))
        tell((step + 1) / config.world.steps)
    positions, aoi, vdf, served = zip(*course, strict=True)
    return Trajectory(
        config=config,
        farm=farm,
        episode=episode,
        position=np.stack(positions),
        assignment=np.array(flown.assignment[0], np.int64),
        sensor_xy=np.array(layout.sensor_xy, np.float64),
        sensor_type=np.array(layout.sensor_type, np.int64),
        aoi=np.array(aoi),
        vdf=np.array(vdf),
        collected=np.cumsum(np.stack(served), axis=0),
        final_aoi=np.array(flown.aoi[0], np.float64),
        final_vdf=np.array(flown.vdf[0], np.float64),
        summary=flown.summary(0),
    )


def episode_seed(farm: int, episode: int) -> int:
    """Return the seed of an evaluation episode."""
    return derive(farm, "evaluation", episode)


def _begin(environments: World, policy: BatchPolicy[World], jobs: Sequence[tuple[int, int]]) -> World:
    """Start one environment on each (farm, episode) and return them."""
    for index, (farm, episode) in enumerate(jobs):
        environments.reset(index, farm, episode_seed(farm, episode))
        policy.reset(environments, index)
    return environments


def _snapshot(farms: FarmBatch) -> tuple[NDArray[np.float64], float, float, NDArray[np.float64]]:
    """Return positions [n, 2], the means of AoI and VDF, and what was served [n] in the last step, of one farm."""
    served = np.array(farms.utility[0], np.float64)
    return np.array(farms.position[0], np.float64), float(farms.aoi[0].mean()), float(farms.vdf[0].mean()), served


def _score(team: TeamSpec, summary: EpisodeSummary) -> Score:
    reward = np.array(summary.reward, np.float64)
    types = {
        group.name: float(reward[agents].mean()) for group, agents in zip(team.groups, team.agent_slices(), strict=True)
    }
    return Score(float(reward.mean()), types, float(summary.steps), dict(summary.metrics), dict(summary.infos))


def _mean(scores: Sequence[Score]) -> Score:
    first = scores[0]
    return Score(
        reward=float(np.mean([score.reward for score in scores])),
        types={name: float(np.mean([score.types[name] for score in scores])) for name in first.types},
        steps=float(np.mean([score.steps for score in scores])),
        metrics={name: float(np.mean([score.metrics[name] for score in scores])) for name in first.metrics},
        infos={
            name: float(np.mean([score.infos[name] for score in scores if name in score.infos]))
            for name in sorted({name for score in scores for name in score.infos})
        },
    )
