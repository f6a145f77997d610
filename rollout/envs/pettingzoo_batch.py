"""Any PettingZoo parallel environment with Box, Discrete or MultiDiscrete actions as a batch of environments."""

import itertools
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import EnvConfig
from eia_sec.common.config.environment import MOST_EPISODE_STEPS
from eia_sec.common.errors import (
    ConfigError,
    ContractError,
    EnvironmentFaultError,
    EnvironmentOutageError,
    SimulationError,
)
from eia_sec.common.log import log
from eia_sec.common.protocol.view_checks import MOST_SENTENCE
from eia_sec.common.seeds import derive
from eia_sec.common.team import Float32, described
from eia_sec.common.text import printable
from eia_sec.rollout.envs.base import Patience
from eia_sec.rollout.envs.batch_rows import BatchRows
from eia_sec.rollout.envs.guard import Guard, for_watchers
from eia_sec.rollout.envs.pettingzoo_actions import RowActions
from eia_sec.rollout.envs.pettingzoo_observations import RowObservations
from eia_sec.rollout.envs.pettingzoo_spec import describe, make_parallel
from eia_sec.rollout.envs.pictures import MAKING_SECONDS, draws, with_pictures

T = TypeVar("T")
FAULTS: Final = (ConfigError, ContractError, EnvironmentFaultError)
"""What is raised when an environment's code does something wrong."""


class PettingZooBatch(BatchRows):
    """A batch of environments that are stepped one after the other.

    An agent that leaves early is in an absorbing state: it observes zeros and earns nothing, and the critics learn that
    its value is 0. Discriminator-Actor-Critic does the same (Kostrikov et al. 2019). Its action mask allows everything.

    Args:
        config: the environment's name, and how its agents form types.
        environments: E.
        boxes: whether environments with a choice are asked for boxes; see `make_parallel`.
        patience: what to do while a simulator or robot is away. With it, an outage in a step truncates the episode, and
            making and resetting are tried until they succeed. Without it, `EnvironmentOutageError` passes through.
        make: makes each environment; by default what the name says.

    Attributes:
        names: the agents in row order.
        observation: [E, O] float32, or bytes where all agents see images, flattened as `gymnasium.spaces.flatten` does,
            each agent's action mask at the end.
        silence: why an environment that was asked for pictures gives none, a sentence, or empty.

    Raises:
        ConfigError: the environment does not exist or cannot be trained.
        ContractError, EnvironmentFaultError: see `eia_sec.rollout.envs.guard`; this holds for every method.
        SimulationError: there is no environment.
    """

    def __init__(
        self,
        config: EnvConfig,
        environments: int,
        *,
        boxes: bool = True,
        patience: Patience | None = None,
        make: Callable[..., Any] | None = None,
    ) -> None:
        if environments < 1:
            raise SimulationError(f"a batch needs at least one environment, not {environments}.")
        self._config = config
        self._made = [config.arguments] * environments
        self._patience, self._away = patience, [False] * environments
        self._attempt = partial(make_parallel, boxes=boxes, make=make)
        self._environments: list[Guard] = []
        with ExitStack() as made:
            made.callback(self.close)
            self._environments += (self._made_anew(k) for k in range(environments))
            agents = self._until_back(0, partial(describe, self._environments[0], config.types))
            made.pop_all()
        super().__init__(config.name, agents.team, environments, config.steps or MOST_EPISODE_STEPS)
        self.names, self.observation = tuple(agents.views), self._unseen()
        self._agents, self._rows = agents, [RowObservations(agents.views)] * environments
        self._actions = RowActions(agents.actions)
        self.silence = ""
        self._drawing = False
        self._watched: set[int] = set()
        self._made_for_pictures: set[int] = set()

    def reset(self, index: int, scenario_seed: int, episode_seed: int) -> None:
        """Start an episode; the environment's seed follows from both seeds."""
        self._renew(index)
        self._renew_for_watchers(index)
        seed = derive(scenario_seed, episode_seed, "reset") % 2**31
        try:
            self._begin(index, seed)
        except FAULTS as error:
            if index not in self._made_for_pictures:
                raise
            self._fall_silent(error)
            self._renew_for_watchers(index)
            self._begin(index, seed)
        self._begin_episode(index, scenario_seed, episode_seed)

    def step(self, action: Float32) -> None:
        """Step every environment whose episode is running with actions [E, A] float32.

        A box's numbers are clipped to [-1, 1], indices of options to those that exist. Environments whose episode has
        ended stand still and earn nothing.

        Raises:
            SimulationError: an environment was never reset or all have ended, or the actions have the wrong shape or
                are not finite.
        """
        self._require_possible(action)
        self.action = rows = self._actions.in_range(action)
        running = np.flatnonzero(~self.ended).tolist()
        if len(running) < len(rows):
            self.reward[self.ended] = 0.0
        acts = [self._actions.by_agent(rows[index], set(self._environments[index].agents)) for index in running]
        for index, actions in zip(running, acts, strict=True):
            self._environments[index].ahead(actions)
        for index, actions in zip(running, acts, strict=True):
            self._step(index, actions)
        self._returns += self.reward

    def change_arguments(self, arguments: str) -> None:
        """Make each environment with other arguments, a JSON object, when its next episode begins.

        Raises:
            ConfigError: they are no JSON object.
        """
        self._config = replace(self._config, arguments=arguments)

    def alive(self, index: int) -> NDArray[np.bool_]:
        """Return which agents [agents] of an environment take part."""
        living = set(self._environments[index].agents)
        return np.array([name in living for name in self.names])

    def ask_for_pictures(self, index: int) -> None:
        """Make an environment anew with a render_mode, where it takes one, when its next episode begins."""
        self._watched.add(index)

    def ask_for_no_pictures(self, index: int) -> None:
        """Make an environment anew without a render_mode that it would not have, when its next episode begins."""
        self._watched.discard(index)

    def picture(self, index: int) -> NDArray[np.uint8] | None:
        """Return what an environment shows [height, width, 3], or None where it shows nothing."""
        if self.silence:
            return None
        try:
            if not draws(self._environments[index]):
                return None
            self._note_drawing(True)
            return self._environments[index].render()
        except (*FAULTS, EnvironmentOutageError) as error:
            self._fall_silent(error)
            return None

    def close(self) -> None:
        """Close all environments."""
        for environment in self._environments:
            environment.close()

    def _made_anew(self, index: int) -> Guard:
        return self._until_back(index, partial(self._attempt, self._config))

    def _renew(self, index: int) -> None:
        """Make an environment anew if its arguments have changed; raise ConfigError if agents or actions change."""
        config = self._config
        if self._made[index] == config.arguments:
            return
        self._environments[index].close()
        self._environments[index] = self._made_anew(index)
        found = self._until_back(index, partial(describe, self._environments[index], config.types))
        if (found.team, tuple(found.views)) != (self.team, self.names):
            raise ConfigError(
                f"with the arguments {config.arguments} {config.name} has {described(found.team)}, and the run trains "
                f"{described(self.team)}; arguments that change while a run trains must keep the team."
            )
        if found.actions != self._agents.actions:  # all environments of the batch share how actions are read
            raise ConfigError(
                f"with the arguments {config.arguments} {config.name} has other action spaces; arguments that change "
                "while a run trains must keep them."
            )
        self._rows[index] = RowObservations(found.views)
        self._made[index] = config.arguments
        self._made_for_pictures.discard(index)

    def _renew_for_watchers(self, index: int) -> None:
        """Replace an environment by one that can be drawn, if it is asked for pictures, or by a plain one, if not."""
        wanted, drawn = index in self._watched and not self.silence, index in self._made_for_pictures
        if drawn and not wanted:
            made = self._made_anew(index)
            with for_watchers(MAKING_SECONDS):
                self._environments[index].close()
            self._environments[index] = made
            self._made_for_pictures.discard(index)
        if wanted and not drawn:
            self._make_for_pictures(index)
        if not self._made_for_pictures and (self.silence or not self._watched):
            self._note_drawing(False)

    def _make_for_pictures(self, index: int) -> None:
        """Replace an environment by one that can be drawn; where there is none, it stays."""
        try:
            if draws(self._environments[index]):
                return
            made = with_pictures(self._config, self._attempt_for_pictures, self._agents)
        except (*FAULTS, EnvironmentOutageError) as error:
            self._fall_silent(error)
            return
        self._environments[index].close()
        self._environments[index] = made
        self._made_for_pictures.add(index)

    def _attempt_for_pictures(self, config: EnvConfig) -> Guard:
        self._note_drawing(True)
        return self._attempt(config)

    def _note_drawing(self, drawing: bool) -> None:
        if drawing != self._drawing:
            self._drawing = drawing
            self.note_drawing(drawing)

    def _fall_silent(self, error: Exception) -> None:
        """Give no more pictures; training goes on without them."""
        log(f"no pictures of {self._config.name}: {error}")
        self.silence = printable(str(error).rstrip().rpartition("\n")[2])[:MOST_SENTENCE]

    def _begin(self, index: int, seed: int) -> None:
        observations, infos = self._until_back(index, partial(self._environments[index].reset, seed))
        self._observe(index, "reset()", observations, infos)

    def _step(self, index: int, actions: dict[Any, Any]) -> None:
        environment, present = self._environments[index], set(actions)
        try:
            step = environment.step(actions)
            # Some environments go on to name agents that have left.
            here = present.union(environment.agents)
            seen = step.observations
            if seen.keys() - here:
                seen = {name: part for name, part in seen.items() if name in here}
            self._observe(index, "step()", seen, step.infos)
        except EnvironmentOutageError as error:
            self._note_outage(index, error)
            self._break_off(index)
            return
        except FAULTS as error:
            if index not in self._made_for_pictures:
                raise
            self._fall_silent(error)
            self._break_off(index)
            return
        self.infos.add(index, step.infos)
        self.time[index] += 1
        self.reward[index] = [step.rewards.get(name, 0.0) for name in self.names]
        ended = all(step.terminations.get(name, False) or step.truncations.get(name, False) for name in here)
        over = not environment.agents or ended
        self.terminated[index] = over and all(step.terminations.get(name, True) for name in present)
        self.ended[index] = over or self.time[index] >= self._limit

    def _break_off(self, index: int) -> None:
        """Truncate the episode with a step that earns nothing and after which the agents see what they saw before."""
        self.time[index] += 1
        self.reward[index] = 0.0
        self.terminated[index], self.ended[index] = False, True

    def _until_back(self, index: int, attempt: Callable[[], T]) -> T:
        """Try until there is no outage any more."""
        for failed in itertools.count(1):
            try:
                found = attempt()
            except EnvironmentOutageError as error:
                self._note_outage(index, error).pause(failed)
                continue
            if self._away[index] and self._patience is not None:
                self._patience.over()
            self._away[index] = False
            return found
        raise AssertionError

    def _note_outage(self, index: int, error: EnvironmentOutageError) -> Patience:
        """Return the patience; raise the error where there is none."""
        if self._patience is None:
            raise error
        if not self._away[index]:
            self._patience.begin(str(error))
        self._away[index] = True
        return self._patience

    def _observe(self, index: int, method: str, observations: Mapping[Any, Any], infos: Mapping[Any, Any]) -> None:
        try:
            self.observation[index] = self._rows[index].row(observations, infos)
        except ContractError as error:
            raise ContractError(f"{self._config.name}: {method} returned {error}") from None
