"""What a worker simulates: a batch of environments of one kind behind one small contract.

    environments = make_environments(config, count)
    environments.reset(index, scenario_seed, episode_seed)          # each index before the first step
    while not environments.ended.any():
        environments.step(action)                                   # reads: observation, reward, terminated
    environments.summary(index)

There is no automatic reset. Where episodes differ in length, an environment whose episode is over stands still and
earns nothing until it is reset; farms all last equally long, and one that is over refuses to step.
"""

from contextlib import closing
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from common.config import RunConfig
from common.environment import EnvironmentSpec
from common.farm import farm_of
from common.protocol.message_sizes import require_frames
from common.team import Float32, TeamSpec
from common.transitions import EpisodeSummary
from rollout.sim.batch import FarmBatch


class Environments(Protocol):
    """A batch of E environments that share a team and nothing else."""

    @property
    def spec(self) -> EnvironmentSpec:
        """Team, episode metrics and what else generic code needs to know."""

    @property
    def team(self) -> TeamSpec:
        """Layout of a row."""

    @property
    def observation(self) -> Float32:
        """[E, O] what everybody sees now."""

    @property
    def reward(self) -> Float32:
        """[E, agents] of the last step."""

    @property
    def potential(self) -> Float32:
        """[E, agents] whose change in a step is part of the reward, as of now; else 0."""

    @property
    def time(self) -> NDArray[np.int64]:
        """[E] steps done in this episode; -1 before the first reset."""

    @property
    def terminated(self) -> NDArray[np.bool_]:
        """[E] whether the last step led to a terminal state: nothing is bootstrapped from it."""

    @property
    def ended(self) -> NDArray[np.bool_]:
        """[E] whether the episode is over, terminated or truncated."""

    def reset(self, index: int, farm_seed: int, episode_seed: int) -> None:
        """Start an episode: a pure function of both seeds and the actions."""

    def step(self, action: Float32) -> None:
        """Step every environment with actions [E, A] in [-1, 1]."""

    def summary(self, index: int) -> EpisodeSummary:
        """Return what the episode of an environment came to so far."""

    def close(self) -> None:
        """Let go of whatever the environments hold outside this process's memory."""


def make_environments(config: RunConfig, count: int) -> Environments:
    """Return `count` environments of a run.

    Raises:
        ConfigError: the environment that the configuration names does not exist or cannot be trained.
    """
    if (farm := farm_of(config)) is not None:
        return FarmBatch(farm, count, config.rollout.threads)
    from rollout.envs.pettingzoo_batch import PettingZooBatch  # noqa: PLC0415  # pettingzoo loads only for those who use it

    return PettingZooBatch(config.env, count)


def environment_spec(config: RunConfig) -> EnvironmentSpec:
    """Return what generic code needs to know of a run's environment.

    Raises:
        ConfigError: as `make_environments`, or its chunks, its actors or its flights for the elite fit into no message.
    """
    with closing(make_environments(config, 1)) as environments:
        require_frames(config, environments.spec)
        return environments.spec
