"""Any PettingZoo parallel environment with Box actions as a batch of environments."""

import itertools

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from common.config import EnvConfig
from common.config.environment import MOST_EPISODE_STEPS
from common.environment import EnvironmentSpec
from common.errors import SimulationError
from common.seeds import derive
from common.team import Float32
from common.transitions import EpisodeSummary
from rollout.envs.pettingzoo_spec import describe, make_parallel


class PettingZooBatch:
    """A batch of environments that are stepped one after the other.

    An agent that leaves early is in an absorbing state: it observes zeros and earns nothing, and the critics learn that
    its value is 0. Discriminator-Actor-Critic does the same (Kostrikov et al. 2019).

    Args:
        config: the environment's name, and how its agents form types.
        environments: E.

    Attributes:
        team: layout of a row, type by type.
        spec: what generic code needs to know; there are no episode metrics.
        names: the agents in row order.
        observation: [E, O] float32, flattened as `gymnasium.spaces.flatten` does.
        reward: [E, agents] float32 of the last step.
        potential: [E, agents] float32, always 0, because the rewards' composition is unknown.
        hindsight: None, for the same reason.
        time: [E] steps done in this episode; -1 before the first reset.
        terminated: [E] whether all remaining agents terminated in the last step.
        ended: [E] whether the episode is over.

    Raises:
        ConfigError: the environment does not exist or cannot be trained.
        SimulationError: there is no environment.
    """

    def __init__(self, config: EnvConfig, environments: int) -> None:
        if environments < 1:
            raise SimulationError(f"a batch needs at least one environment, not {environments}.")
        self._limit = config.steps or MOST_EPISODE_STEPS
        self._environments = [make_parallel(config) for _ in range(environments)]
        first = self._environments[0]
        agents = describe(first, config.prefixes())
        self.names, self.team = agents.names, agents.team
        self.spec = EnvironmentSpec(agents.team, (1, config.steps or MOST_EPISODE_STEPS))
        self._low, self._high = agents.low, agents.high
        self._seen = [first.observation_space(name) for name in self.names]
        self._acted = [first.action_space(name) for name in self.names]
        sizes = [(g.observation_size, g.action_size) for g in self.team.groups for _ in range(g.count)]
        ends = np.cumsum([(0, 0), *sizes], axis=0).tolist()
        self._observations = [slice(a[0], b[0]) for a, b in itertools.pairwise(ends)]
        self._actions = [slice(a[1], b[1]) for a, b in itertools.pairwise(ends)]
        self.observation: Float32 = np.zeros((environments, self.team.observation_size), np.float32)
        self.reward: Float32 = np.zeros((environments, self.team.agents), np.float32)
        self.potential: Float32 = np.zeros_like(self.reward)
        self.hindsight: Float32 | None = None
        self.time: NDArray[np.int64] = np.full(environments, -1, np.int64)
        self.terminated: NDArray[np.bool_] = np.zeros(environments, np.bool_)
        self.ended: NDArray[np.bool_] = np.zeros(environments, np.bool_)
        self._returns = np.zeros((environments, self.team.agents))
        self._seeds = [(-1, -1)] * environments

    def reset(self, index: int, scenario_seed: int, episode_seed: int) -> None:
        """Start an episode; the environment's seed follows from both seeds.

        Raises:
            SimulationError: the environment returns values outside its own spaces.
        """
        self._seeds[index] = (scenario_seed, episode_seed)
        observations, _ = self._environments[index].reset(seed=derive(scenario_seed, episode_seed, "reset") % 2**31)
        self.time[index] = 0
        self.reward[index] = self._returns[index] = 0.0
        self.terminated[index] = self.ended[index] = False
        self._observe(index, observations)

    def step(self, action: Float32) -> None:
        """Step every environment whose episode is running with actions [E, A] float32, clipped to [-1, 1].

        Environments whose episode has ended stand still and earn nothing.

        Raises:
            SimulationError: an environment was never reset or all have ended, the actions have the wrong shape or are
                not finite, or an environment returns values outside its spaces.
        """
        wanted = (len(self.time), self.team.action_size)
        if action.shape != wanted or not np.isfinite(action).all():
            raise SimulationError(f"actions must be finite numbers of shape {list(wanted)}.")
        if self.time.min() < 0 or self.ended.all():
            raise SimulationError("an environment was stepped before its reset or after its episode ended.")
        share = (np.clip(action, -1.0, 1.0) + 1.0) / 2.0
        spread = np.clip(self._low + share * (self._high - self._low), self._low, self._high)
        for index, row in enumerate(spread):
            if self.ended[index]:
                self.reward[index] = 0.0
            else:
                self._step(index, row)

    def summary(self, index: int) -> EpisodeSummary:
        """Return the summary of an environment's episode so far; raise SimulationError before the first."""
        if self.time[index] < 0:
            raise SimulationError(f"environment {index} has not been reset yet.")
        return EpisodeSummary(*self._seeds[index], int(self.time[index]), tuple(self._returns[index].tolist()), {})

    def close(self) -> None:
        """Close all environments."""
        for environment in self._environments:
            environment.close()

    def _step(self, index: int, row: Float32) -> None:
        environment = self._environments[index]
        present = set(environment.agents)
        actions = {
            name: row[part].reshape(space.shape).astype(space.dtype)
            for name, part, space in zip(self.names, self._actions, self._acted, strict=True)
            if name in present
        }
        observations, rewards, terminations, _, _ = environment.step(actions)
        self.time[index] += 1
        self.reward[index] = [float(rewards.get(name, 0.0)) for name in self.names]
        if not np.isfinite(self.reward[index]).all():
            raise SimulationError(f"the environment's reward is not finite: {rewards}.")
        self._returns[index] += self.reward[index]
        self._observe(index, observations)
        over = not environment.agents
        self.terminated[index] = over and all(terminations.get(name, True) for name in present)
        self.ended[index] = over or self.time[index] >= self._limit

    def _observe(self, index: int, observations: dict[str, object]) -> None:
        target = self.observation[index]
        target[:] = 0.0
        for name, part, space in zip(self.names, self._observations, self._seen, strict=True):
            if name in observations:
                flat = np.asarray(spaces.flatten(space, observations[name]), np.float32).reshape(-1)
                if flat.shape != (part.stop - part.start,) or not np.isfinite(flat).all():
                    raise SimulationError(f"the observation of agent {name} does not fit its space or is not finite.")
                target[part] = flat
