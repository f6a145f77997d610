"""The interface between a worker and its environments: a batch of environments of one kind.

    environments = make_environments(config, count)                 # eia_sec.rollout.envs.registry
    environments.reset(index, scenario_seed, episode_seed)          # each index before the first step
    while not environments.ended.any():
        environments.step(action)                                   # then read observation, reward, terminated
    environments.summary(index)

There is no automatic reset. Where episodes differ in length, a finished environment stands still and earns nothing
until its reset. Farm episodes all have the same length, and a finished farm refuses to step.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.team import Float32, TeamSpec
from eia_sec.common.transitions import EpisodeSummary
from eia_sec.common.transport.bus import Bus


class Patience(Protocol):
    """What to do while simulators or robots are away."""

    def begin(self, said: str) -> None:
        """Note that one has gone away, and what its environment says of it."""

    def pause(self, failed: int) -> None:
        """Wait after so many failed tries in a row; raise CancelledError when it is not to be waited for any longer."""

    def over(self) -> None:
        """Note that one is back."""


@dataclass(frozen=True)
class Reach:
    """How environments are reached that others serve.

    Attributes:
        bus: the control lane.
        holder: under which name they are claimed.
    """

    bus: Bus
    holder: str


class Environments(Protocol):
    """A batch of E environments that share a team and nothing else."""

    @property
    def spec(self) -> EnvironmentSpec:
        """Team, episode metrics and whatever else generic code needs to know."""

    @property
    def team(self) -> TeamSpec:
        """Layout of a row."""

    @property
    def observation(self) -> Float32:
        """[E, O] current observations of all agents; bytes where all see images."""

    @property
    def reward(self) -> Float32:
        """[E, agents] rewards of the last step."""

    @property
    def potential(self) -> Float32:
        """[E, agents] potential Phi of the current state, for reward shaping; 0 if there is none."""

    @property
    def hindsight(self) -> Float32 | None:
        """[E, T, agents] corrections to the rewards of the running or just ended episode's T steps.

        Reward plus correction pays each agent what it turned out to be worth to the team, as far as known by now. A
        reset sets them to 0. None if the environment knows nothing of the kind, or was not made to track it.
        """

    @property
    def time(self) -> NDArray[np.int64]:
        """[E] steps done in this episode; -1 before the first reset."""

    @property
    def terminated(self) -> NDArray[np.bool_]:
        """[E] whether the last step led to a terminal state, from which nothing is bootstrapped."""

    @property
    def ended(self) -> NDArray[np.bool_]:
        """[E] whether the episode is over, terminated or truncated."""

    def reset(self, index: int, scenario_seed: int, episode_seed: int, /) -> None:
        """Start an episode, which is a pure function of both seeds and the actions."""

    def step(self, action: Float32) -> None:
        """Step every environment with actions [E, A]: in [-1, 1], or indices of options."""

    def summary(self, index: int) -> EpisodeSummary:
        """Return the summary of an environment's episode so far."""

    def close(self) -> None:
        """Release all resources outside this process's memory."""
