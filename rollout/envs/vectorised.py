"""Environments that step as one batch: the class to derive one's own from, and the batch that a worker steps.

    class Grid(Vectorised):                       # --env mytask.grid:Grid
        def __init__(self, environments, threads, size=8): ...

A batch of a compiled or tensor simulator costs one call a step instead of one for each environment.
"""

import importlib
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from typing import Any, ClassVar, Final

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from eia_sec.common.config import EnvConfig
from eia_sec.common.config.environment import MOST_EPISODE_STEPS
from eia_sec.common.errors import ConfigError, ContractError, SimulationError
from eia_sec.common.seeds import derive
from eia_sec.common.team import Float32
from eia_sec.common.transitions import LARGEST, EpisodeSummary
from eia_sec.rollout.envs.batch_rows import BatchRows
from eia_sec.rollout.envs.guard import calling, factory, shown
from eia_sec.rollout.envs.pettingzoo_actions import RowActions, is_bounded_box, is_choice
from eia_sec.rollout.envs.pettingzoo_spec import Agents, describe

SHIPPED: Final = {
    "vmas": ("vmas", "eia_sec.rollout.envs.vmas_scenarios:VmasScenario"),
    "jaxmarl": ("jaxmarl", "eia_sec.rollout.envs.jaxmarl_environments:JaxMarlEnvironment"),
}
"""What a name begins with: the extra that installs it, and the class, whose first keyword is the rest of the name."""

ByAgent = Mapping[Any, NDArray[Any]]
"""Arrays by the name of an agent; their first axis is that of the environments, [E, ...]."""


class Vectorised(ABC):
    """E environments of one kind that step as one batch.

    The class is made with the number of environments, the threads that it may use, and `env.arguments` as keywords.
    There is no automatic reset: an environment whose episode has ended is stepped with the others until its reset, and
    what it then shows and earns is not read.

    Attributes:
        possible_agents: names of the agents, which all take part from the first step to the last.
        steps: steps after which an episode is truncated where env.steps does not say so; 0 for no limit.
    """

    possible_agents: Sequence[Any]
    steps: ClassVar[int] = 0

    @abstractmethod
    def __init__(self, environments: int, threads: int, **arguments: Any) -> None:
        """Make the environments."""

    @abstractmethod
    def observation_space(self, agent: Any) -> spaces.Space[Any]:
        """Return an agent's observation space, a Box."""

    @abstractmethod
    def action_space(self, agent: Any) -> spaces.Space[Any]:
        """Return an agent's action space: a bounded Box, Discrete or MultiDiscrete."""

    @abstractmethod
    def reset(self, index: int, seed: int) -> None:
        """Begin an episode in one environment, which is a pure function of the seed and the actions."""

    @abstractmethod
    def observe(self) -> ByAgent:
        """Return what the agents see now, [E, ...] each."""

    @abstractmethod
    def step(self, actions: ByAgent) -> tuple[ByAgent, NDArray[np.bool_], NDArray[np.bool_]]:
        """Step all environments.

        Args:
            actions: [E, ...] of each agent, in its action space.

        Returns:
            rewards [E] by agent, and [E] whether episodes terminated, and whether they were truncated.
        """

    def numbers(self) -> Mapping[str, NDArray[Any]]:
        """Return numbers [E] of the last step that become metrics of their episodes, by name."""
        return {}

    def close(self) -> None:  # noqa: B027  # most hold nothing
        """Release all resources outside this process's memory."""


def vectorised_class(name: str) -> tuple[type[Vectorised], dict[str, Any]] | None:
    """Return the class that an environment's name stands for and its first keywords; None for any other environment.

    Raises:
        ConfigError: there is no such environment, or the extra that it needs is not installed.
        EnvironmentFaultError: its module cannot be imported.
    """
    prefix, _, rest = name.partition(":")
    if prefix in SHIPPED:
        extra, path = SHIPPED[prefix]
        module, _, member = path.partition(":")
        with calling(name, f"import {prefix}"):
            try:
                importlib.import_module(prefix)
            except ImportError as error:
                raise ConfigError(f'{name} needs {prefix}: pip install "eia-sec[{extra}]" ({error}).') from None
            found = getattr(importlib.import_module(module), member)
        return found, {"name": rest}
    found = factory(name)
    return (found, {}) if isinstance(found, type) and issubclass(found, Vectorised) else None


class _Described:
    """What `describe` asks of an environment; there are no action masks."""

    def __init__(self, made: Vectorised) -> None:
        self.possible_agents = list(made.possible_agents)
        self.observation_space, self.action_space = made.observation_space, made.action_space

    def reset(self, seed: int) -> tuple[dict[Any, Any], dict[Any, Any]]:
        return {}, {}


class VectorisedBatch(BatchRows):
    """A batch of environments that step as one; see `eia_sec.rollout.envs.base.Environments` for its attributes.

    Args:
        config: the environment's name and arguments, and how its agents form types.
        environments: E.
        threads: most threads of a step.

    Attributes:
        agents: the agents in row order.
        names: their names.
        silence: why there are no pictures.

    Raises:
        ConfigError: the environment does not exist or cannot be trained.
        ContractError, EnvironmentFaultError: see `eia_sec.rollout.envs.guard`; this holds for every method.
        SimulationError: there is no environment.
    """

    silence: Final = "environments that step as one batch give no pictures."

    def __init__(self, config: EnvConfig, environments: int, threads: int) -> None:
        if environments < 1:
            raise SimulationError(f"a batch needs at least one environment, not {environments}.")
        found = vectorised_class(config.name)
        if found is None:
            raise ConfigError(f"{config.name} is no class derived from Vectorised.")
        kind, first = found
        self._name = config.name
        with calling(config.name, kind.__name__):
            self._made = kind(environments, threads, **first, **config.keywords())
        with ExitStack() as failed:
            failed.callback(self.close)
            self.agents = self._described(config)
            failed.pop_all()
        limit = config.steps or kind.steps or MOST_EPISODE_STEPS
        super().__init__(config.name, self.agents.team, environments, limit)
        self.names, self._actions = tuple(self.agents.views), RowActions(self.agents.actions)
        self._observation, self._begun = self._unseen(), np.zeros(environments, np.bool_)
        self._sums: dict[str, NDArray[np.float64]] = {}

    @property
    def observation(self) -> Float32:
        """[E, O] current observations; those of environments that were reset are read when they are asked for."""
        if self._begun.any():
            rows, self._begun[:] = self._begun.copy(), False
            self._observe(rows)
        return self._observation

    def reset(self, index: int, scenario_seed: int, episode_seed: int) -> None:
        """Start an episode; the environment's seed follows from both seeds."""
        with calling(self._name, "reset()"):
            self._made.reset(index, derive(scenario_seed, episode_seed, "reset") % 2**31)
        self._begin_episode(index, scenario_seed, episode_seed)
        self._begun[index] = True
        for sums in self._sums.values():
            sums[index] = 0.0

    def step(self, action: Float32) -> None:
        """Step every environment with actions [E, A] float32; ended episodes stand still and earn nothing.

        Raises:
            SimulationError: an environment was never reset or all have ended, or the actions have the wrong shape or
                are not finite.
        """
        self._require_possible(action)
        self.action, running = self._actions.in_range(action), ~self.ended
        with calling(self._name, "step()"):
            found = self._made.step(self._actions.columns(self.action))
            if not isinstance(found, tuple) or len(found) != 3:
                raise self._misfit("step()", found, "rewards by agent, terminations and truncations")
            rewards, terminated, truncated = found
            earned = [self._column("step()", "rewards", rewards, name, ()) for name in self.names]
            ends = [self._flags(what, flags) for what, flags in (("ter", terminated), ("trunc", truncated))]
            numbers = self._made.numbers()
        reward = np.stack(earned, axis=1)
        self._require_in_range("step()", "rewards", reward, running)
        self.reward = np.where(running[:, None], reward, np.float32(0.0))
        self._returns += self.reward
        self.time += running
        for name, values in numbers.items():
            self._sums.setdefault(name, np.zeros(len(running)))[running] += np.asarray(values, np.float64)[running]
        self.terminated = running & ends[0] | self.terminated & ~running
        self.ended = ~running | ends[0] | ends[1] | (self.time >= self._limit)
        self._observe(running)

    def summary(self, index: int) -> EpisodeSummary:
        """Return the summary of an environment's episode so far; raise SimulationError before the first."""
        steps = max(1, int(self.time[index]))
        self.infos.begin(index)
        self.infos.add(index, {"": {name: sums[index] / steps for name, sums in self._sums.items()}})
        return super().summary(index)

    def close(self) -> None:
        """Close the environments."""
        with calling(self._name, "close()"):
            self._made.close()

    def alive(self, index: int) -> NDArray[np.bool_]:
        """Return which agents [agents] of an environment take part: all."""
        return np.ones(self.team.agents, np.bool_)

    def ask_for_pictures(self, index: int) -> None:
        """Do nothing."""

    def ask_for_no_pictures(self, index: int) -> None:
        """Do nothing."""

    def picture(self, index: int) -> None:
        """Return None: there are no pictures."""

    def _described(self, config: EnvConfig) -> Agents:
        with calling(self._name, "possible_agents"):
            made = _Described(self._made)
            for name in made.possible_agents:
                seen, acts = made.observation_space(name), made.action_space(name)
                if not isinstance(seen, spaces.Box):
                    raise ConfigError(f"the observation of agent {name} of {self._name} is no Box but {shown(seen)}.")
                if not (is_bounded_box(acts) or is_choice(acts)):
                    raise ConfigError(
                        f"{self._name} has actions other than bounded boxes, Discrete and MultiDiscrete; only these "
                        "can be trained."
                    )
            return describe(made, config.types)

    def _observe(self, rows: NDArray[np.bool_]) -> None:
        """Take over what the agents of some environments see."""
        with calling(self._name, "observe()"):
            seen = self._made.observe()
            parts = [
                self._column("observe()", "observations", seen, name, view.space.shape or ())
                for name, view in self.agents.views.items()
            ]
        found = np.concatenate([part.reshape(len(rows), -1) for part in parts], axis=1)
        self._require_in_range("observe()", "observations", found, rows)
        self._observation[rows] = found[rows]

    def _column(self, method: str, what: str, given: Any, name: Any, shape: tuple[int, ...]) -> NDArray[Any]:
        """Return an agent's numbers [E, *shape]; raise ContractError if there are none."""
        if not isinstance(given, Mapping) or name not in given:
            raise self._misfit(method, given, f"{what} of agent {name}")
        found = np.asarray(given[name])
        if found.shape != (len(self.time), *shape) or found.dtype.kind not in "fiub":
            raise self._misfit(method, found, f"{what} of agent {name} of shape {[len(self.time), *shape]}")
        return found if found.dtype == np.uint8 else found.astype(np.float32)

    def _flags(self, what: str, given: Any) -> NDArray[np.bool_]:
        flags = np.asarray(given)
        if flags.shape != self.time.shape or flags.dtype != np.bool_:
            raise self._misfit("step()", given, f"{what}minations" if what == "ter" else f"{what}ations")
        return flags

    def _require_in_range(self, method: str, what: str, found: NDArray[Any], rows: NDArray[np.bool_]) -> None:
        if (np.abs(found[rows]) <= LARGEST).all():
            return
        row, column = (int(part[0]) for part in np.nonzero(~(np.abs(found) <= LARGEST) & rows[:, None]))
        raise ContractError(
            f"{self._name}: {method} returned {what} with {found[row, column]:g} in environment {row}, column {column} "
            f"of a row; the largest is {LARGEST:g}: return finite numbers, divided by their scale."
        )

    def _misfit(self, method: str, came: Any, wanted: str) -> ContractError:
        return ContractError(
            f"{self._name}: {method} gave {shown(came)}; Vectorised asks for {wanted}, one for each of its "
            f"{len(self.time)} environments."
        )
