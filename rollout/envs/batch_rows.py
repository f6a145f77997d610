"""What batches of environments from outside have in common: the arrays of a worker's rows, and episodes in them."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.errors import SimulationError
from eia_sec.common.team import Float32, TeamSpec
from eia_sec.common.transitions import EpisodeSummary, observation_type
from eia_sec.rollout.envs.episode_infos import EpisodeInfos


class BatchRows:
    """The arrays of a batch of environments.

    Args:
        name: the environment's name.
        team: layout of a row, type by type.
        environments: E.
        limit: most steps of an episode.

    Attributes:
        team: the same.
        spec: what generic code needs to know; there are no episode metrics but `infos`.
        reward: [E, agents] float32 of the last step.
        action: [E, A] float32 of the last step, as the environments got them.
        potential: [E, agents] float32, always 0, because the rewards' composition is unknown.
        hindsight: None, for the same reason.
        time: [E] steps done in this episode; -1 before the first reset.
        terminated: [E] whether all remaining agents terminated in the last step.
        ended: [E] whether the episode is over.
        infos: the numbers that steps give besides.
        note_drawing: called with True before code that draws runs, and with False once none does any more.
    """

    def __init__(self, name: str, team: TeamSpec, environments: int, limit: int) -> None:
        self.team, self._limit = team, limit
        self.spec = EnvironmentSpec(team, (1, limit))
        self.reward: Float32 = np.zeros((environments, team.agents), np.float32)
        self.action: Float32 = np.zeros((environments, team.action_size), np.float32)
        self.potential: Float32 = np.zeros_like(self.reward)
        self.hindsight: Float32 | None = None
        self.time: NDArray[np.int64] = np.full(environments, -1, np.int64)
        self.terminated: NDArray[np.bool_] = np.zeros(environments, np.bool_)
        self.ended: NDArray[np.bool_] = np.zeros(environments, np.bool_)
        self.infos = EpisodeInfos(environments, name)
        self.note_drawing: Callable[[bool], None] = lambda drawing: None
        self._returns = np.zeros((environments, team.agents))
        self._seeds = [(-1, -1)] * environments

    def _unseen(self) -> Float32:
        """Return room for all observations, [E, O] float32, or bytes where all agents see images."""
        return np.zeros((len(self.time), self.team.observation_size), observation_type(self.team, rounded=False))

    def _begin_episode(self, index: int, scenario_seed: int, episode_seed: int) -> None:
        """Begin an environment's episode: nothing was done and earned yet."""
        self._seeds[index] = (scenario_seed, episode_seed)
        self.infos.begin(index)
        self.time[index] = 0
        self.reward[index] = self.action[index] = self._returns[index] = 0.0
        self.terminated[index] = self.ended[index] = False

    def _require_possible(self, action: Float32) -> None:
        """Raise SimulationError unless actions are finite numbers [E, A] and a step can be made."""
        if action.shape != self.action.shape or not np.isfinite(action).all():
            raise SimulationError(f"actions must be finite numbers of shape {list(self.action.shape)}.")
        if self.time.min() < 0 or self.ended.all():
            raise SimulationError("an environment was stepped before its reset or after its episode ended.")

    def summary(self, index: int) -> EpisodeSummary:
        """Return the summary of an environment's episode so far; raise SimulationError before the first."""
        if self.time[index] < 0:
            raise SimulationError(f"environment {index} has not been reset yet.")
        rewards = tuple(self._returns[index].tolist())
        return EpisodeSummary(*self._seeds[index], int(self.time[index]), rewards, {}, self.infos.means(index))

    def seeds(self, index: int) -> tuple[int, int]:
        """Return the scenario seed and the episode seed of an environment's episode."""
        return self._seeds[index]
