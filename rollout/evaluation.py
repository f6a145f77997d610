"""Noise-free evaluation: fly a policy over farms and say what each episode came to."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from common.config import FarmConfig
from common.errors import ConfigError
from common.seeds import derive
from common.team import TeamSpec, farm_team
from common.transitions import EpisodeSummary
from rollout.farms import FarmBatch
from rollout.policies import Policy

BATCH: Final = 32
"""Episodes that are flown side by side; results do not depend on it."""


@dataclass(frozen=True)
class Score:
    """Means over episodes.

    Attributes:
        reward: sum of an episode's rewards, mean over all agents.
        communication: the same over the communication UAVs.
        monitoring: the same over the monitoring UAVs.
        collection: the same over the data collection UAVs.
        aoi: mean AoI over sensors and steps, units.
        vdf: mean VDF over plots and steps, units.
        collisions: UAV steps closer than the collision distance, per episode.
        boundary: UAV steps against the field's edge, per episode.
        energy_j: energy of all UAVs, per episode, J.
    """

    reward: float
    communication: float
    monitoring: float
    collection: float
    aoi: float
    vdf: float
    collisions: float
    boundary: float
    energy_j: float


@dataclass(frozen=True)
class Evaluation:
    """What a policy came to on a set of farms.

    Attributes:
        policy: its name.
        farms: seeds of the farms.
        episodes: episodes on each farm.
        total: means over all farms.
        per_farm: means over the episodes of each farm, in the order of `farms`.
    """

    policy: str
    farms: tuple[int, ...]
    episodes: int
    total: Score
    per_farm: tuple[Score, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the evaluation as `eia-sec evaluate --json` prints it."""
        total = self.total
        return {
            "policy": self.policy,
            "farms": list(self.farms),
            "episodes": self.episodes,
            "reward": {"mean": total.reward, "c": total.communication, "m": total.monitoring, "d": total.collection},
            **_rest(total),
            "per_farm": [
                {
                    "farm": farm,
                    "reward": score.reward,
                    "c": score.communication,
                    "m": score.monitoring,
                    "d": score.collection,
                    **_rest(score),
                }
                for farm, score in zip(self.farms, self.per_farm, strict=True)
            ],
        }


@dataclass(frozen=True)
class Trajectory:
    """One episode, as a picture needs it.

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
        final_aoi: [S] units.
        final_vdf: [n_px, n_py] units.
        summary: what the episode came to.
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
    final_aoi: NDArray[np.float64]
    final_vdf: NDArray[np.float64]
    summary: EpisodeSummary


def evaluate(
    config: FarmConfig, policy: Policy, farms: Sequence[int], episodes: int, *, name: str, batch: int = BATCH
) -> Evaluation:
    """Fly a policy over farms.

    Args:
        config: the farm.
        policy: what flies.
        farms: seeds of the farms.
        episodes: episodes on each farm; number k has the seed `episode_seed(farm, k)`.
        name: the policy's name in the result.
        batch: episodes flown side by side.

    Raises:
        ConfigError: there is no farm or no episode to fly.
        PolicyError: the policy does not fit the farm.
    """
    if not farms or episodes < 1 or batch < 1:
        raise ConfigError("an evaluation needs at least one farm, one episode and a batch of one.")
    jobs = [(farm, episode) for farm in farms for episode in range(episodes)]
    team = farm_team(config)
    scores: list[Score] = []
    for first in range(0, len(jobs), batch):
        flown = _begin(config, policy, jobs[first : first + batch])
        for _ in range(config.world.steps):
            flown.step(policy.act(flown))
        scores += [_score(team, flown.summary(index)) for index in range(len(flown.position))]
    per_farm = [_mean(scores[first : first + episodes]) for first in range(0, len(jobs), episodes)]
    return Evaluation(name, tuple(farms), episodes, _mean(per_farm), tuple(per_farm))


def record(config: FarmConfig, policy: Policy, farm: int, episode: int) -> Trajectory:
    """Fly one episode and keep its course; it is the same episode that `evaluate` flies.

    Raises:
        PolicyError: the policy does not fit the farm.
    """
    flown = _begin(config, policy, [(farm, episode)])
    layout = flown.layout(0)
    course = [_snapshot(flown)]
    for _ in range(config.world.steps):
        flown.step(policy.act(flown))
        course.append(_snapshot(flown))
    positions, aoi, vdf = zip(*course, strict=True)
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
        final_aoi=np.array(flown.aoi[0], np.float64),
        final_vdf=np.array(flown.vdf[0], np.float64),
        summary=flown.summary(0),
    )


def episode_seed(farm: int, episode: int) -> int:
    """Return the seed of an evaluation episode."""
    return derive(farm, "evaluation", episode)


def _begin(config: FarmConfig, policy: Policy, jobs: Sequence[tuple[int, int]]) -> FarmBatch:
    """Return a batch with one environment at the start of each (farm, episode)."""
    farms = FarmBatch(config, len(jobs))
    for index, (farm, episode) in enumerate(jobs):
        farms.reset(index, farm, episode_seed(farm, episode))
        policy.reset(farms, index)
    return farms


def _snapshot(farms: FarmBatch) -> tuple[NDArray[np.float64], float, float]:
    """Return positions [n, 2] and the means of AoI and VDF of a batch of one."""
    return np.array(farms.position[0], np.float64), float(farms.aoi[0].mean()), float(farms.vdf[0].mean())


def _score(team: TeamSpec, summary: EpisodeSummary) -> Score:
    reward = np.array(summary.reward, np.float64)
    communication, monitoring, collection = (float(reward[agents].mean()) for agents in team.agent_slices())
    return Score(
        reward=float(reward.mean()),
        communication=communication,
        monitoring=monitoring,
        collection=collection,
        aoi=summary.aoi,
        vdf=summary.vdf,
        collisions=summary.collisions,
        boundary=summary.boundary,
        energy_j=summary.energy_j,
    )


def _mean(scores: Sequence[Score]) -> Score:
    names = [field.name for field in fields(Score)]
    return Score(**{name: float(np.mean([getattr(score, name) for score in scores])) for name in names})


def _rest(score: Score) -> dict[str, float]:
    """Return what an evaluation says besides the reward."""
    return {name: getattr(score, name) for name in ("aoi", "vdf", "collisions", "boundary", "energy_j")}
