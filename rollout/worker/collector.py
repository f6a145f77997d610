"""Collection of experience: a batch of environments stepped with the newest actors and exploration noise."""

from collections.abc import Callable, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import RunConfig
from eia_sec.common.errors import CancelledError
from eia_sec.common.protocol.bfloat16 import to_bits
from eia_sec.common.seeds import derive, stream
from eia_sec.common.team import Float32, TeamSpec
from eia_sec.common.transitions import (
    TERMINATED,
    TRANSITION,
    TRUNCATED,
    Chunk,
    EpisodeSummary,
    Rows,
    Seen,
    observation_type,
)
from eia_sec.rollout.envs.base import Patience, Reach
from eia_sec.rollout.envs.registry import change_arguments, infos_alarm, make_environments
from eia_sec.rollout.worker.action_sampler import ActionSampler
from eia_sec.rollout.worker.hindsight_credit import credit_newest, shares_of
from eia_sec.rollout.worker.random_rows import RandomRows
from eia_sec.rollout.worker.reward_shaping import RewardShaping


class StepObserver(Protocol):
    """Records one environment, as `eia_sec.rollout.worker.probe.Probe` does."""

    index: int

    def record(self) -> None:
        """Record the current state; called after every reset and every step of the environment."""


class Collector:
    """One worker's environments.

    A whole chunk is `chunk_steps` steps of every environment. An episode's farm or scenario, its seed and its noise
    depend only on (run seed, worker, start, environment, episode number), never on other processes.

    Args:
        config: the run.
        worker: the worker's name.
        start: number of this start of the worker; the same number repeats the same episodes.
        patience: waits while an environment's simulator or robot is away, see `make_environments`.
        reach: how environments are reached that others serve.

    Attributes:
        environments: the batch.
        team: layout of a row.
        chunk_steps: steps of all environments in a whole chunk.
        environment_steps: steps of all environments in the chunks that were collected.
        simulated: the same with those of the chunk that is being collected.
        probe: records one environment while somebody watches, else None; the experience does not depend on it.

    Raises:
        ConfigError: the environment does not exist or cannot be trained.
        CancelledError: the patience was at an end before all environments had begun.
    """

    def __init__(
        self,
        config: RunConfig,
        worker: str,
        start: int,
        patience: Patience | None = None,
        reach: Reach | None = None,
    ) -> None:
        self._config = config
        self._identity = (config.seed, worker, start)
        count = config.rollout.environments
        by_type = config.on_policy.hindsight if config.learns_on_policy else {}
        self.environments = make_environments(config, count, any(by_type.values()), patience, reach)
        self.team = self.environments.team
        self._share = shares_of(self.team, by_type)
        ends = config.learns_on_policy and config.on_policy.time_limit == "terminal"
        self._shaping = RewardShaping(self.environments, config.algorithm.potential_discount, ends=ends)
        self.environment_steps = self.simulated = 0
        self.chunk_steps = count * config.rollout.chunk_steps
        self.probe: StepObserver | None = None
        self._episode: NDArray[np.int64] = np.full(count, -1, np.int64)
        self._noise = RandomRows((*self._identity, "noise"), count, self.team.action_size)
        self._sampler = ActionSampler(self.team)
        self._all_choices = all(group.choices for group in self.team.groups)
        self._uniform = RandomRows((*self._identity, "uniform"), count, self.team.action_size)
        self._state: Float32 | None = None
        if config.memory_size:
            self._state = np.zeros((count, self.team.agents, config.memory_size), np.float32)
        with ExitStack() as failed:
            failed.callback(self.close)
            self._begin_episodes()
            failed.pop_all()

    def close(self) -> None:
        """Close the environments."""
        self.environments.close()

    @property
    def alarm(self) -> str:
        """A sentence about numbers in infos that cannot become metrics, or an empty string."""
        return infos_alarm(self.environments)

    def change_arguments(self, arguments: str) -> None:
        """Make each environment with other arguments, a JSON object, when its next episode begins.

        Raises:
            ConfigError: the run's environment takes no arguments, or they are no JSON object.
        """
        change_arguments(self.environments, arguments)

    def collect(
        self, actors: TeamActors, noise_std: float, uniform: bool, goes_on: Callable[[], bool] = lambda: True
    ) -> Chunk:
        """Collect one chunk.

        Args:
            actors: the actors.
            noise_std: standard deviation of the Gaussian noise on a deterministic head's action, 0..1, or epsilon for
                values of options; without meaning for algorithms that learn on policy, whose actions are sampled from
                the actors' distributions.
            uniform: draw actions uniformly instead (warm-up); without meaning for those algorithms, too.
            goes_on: called after each step, because a chunk may take many seconds; after False, the chunk ends with
                that step.

        Returns:
            The rows of all environments, one environment after the other, and the episodes that ended. Rewards in rows
            may be shaped (`eia_sec.rollout.worker.reward_shaping`); rewards of episodes are not.

        Raises:
            CancelledError: an environment was away until the patience was at an end, and no step was made before.
        """
        environments, steps = self.environments, self._config.rollout.chunk_steps
        rows = _ChunkRows(
            len(environments.time),
            steps,
            self.team,
            log_probabilities=self._config.learns_on_policy,
            rounded=self._config.bfloat16_observations,
        )
        self._begin_episodes()
        state = None if self._state is None else self._state.copy()
        episodes: list[EpisodeSummary] = []
        done, last = 0, False
        while not last:
            rows.write_observation(done, environments.observation)
            action, log_probability, adapted = self._select_actions(actors, noise_std, uniform)
            self._shaping.before_step()
            environments.step(adapted)
            self.simulated += len(environments.time)
            if self.probe is not None:
                self.probe.record()
            rows.action[:, done], rows.log_probability[:, done] = action, log_probability
            rows.reward[:, done] = self._shaping.shaped_reward()
            done += 1
            last = not goes_on() or done == steps
            if last or environments.ended.any():  # else the next step writes these observations
                rows.write_observation(done, environments.observation)
                episodes += self._end_episodes(rows, done)
                last = last or not self._could_begin()
        for running in np.flatnonzero(~environments.ended):
            self._credit(rows, int(running), done)
        self.environment_steps = self.simulated
        return Chunk(replace(rows.rows(done), state=state), tuple(episodes))

    def _select_actions(self, actors: TeamActors, noise_std: float, uniform: bool) -> tuple[Float32, Float32, Float32]:
        """Return actions, log-probabilities [E, agents], or [E, 0] off policy, and the actions adapted."""
        if self._config.learns_on_policy:
            return self._sample(actors)
        action = self._explore(actors, noise_std, uniform)
        return action, np.zeros((len(action), 0), np.float32), self.team.adapt(self.environments.observation, action)

    def _end_episodes(self, rows: "_ChunkRows", done: int) -> list[EpisodeSummary]:
        """Close the episodes that ended in the chunk's newest step.

        Args:
            rows: the chunk's rows, with the observations after that step.
            done: its steps so far.

        Returns:
            Summaries of the episodes.
        """
        environments = self.environments
        summaries = []
        for index in map(int, np.flatnonzero(environments.ended)):
            self._credit(rows, index, done)
            rows.end(index, done, bool(environments.terminated[index]))
            summaries.append(environments.summary(index))
        return summaries

    def _sample(self, actors: TeamActors) -> tuple[Float32, Float32, Float32]:
        """Return actions sampled from the actors' distributions, their log-probabilities, and the actions adapted."""
        environments = self.environments
        uniform = self._uniform.at(self._episode, environments.time, normal=False)
        # Choices take no normal numbers, so that drawing them would be for nothing.
        normal = uniform if self._all_choices else self._noise.at(self._episode, environments.time, normal=True)
        return self._sampler.sample(actors, environments.observation, normal, uniform, self._state)

    def _explore(self, actors: TeamActors, noise_std: float, uniform: bool) -> Float32:
        environments = self.environments
        if uniform or self._all_choices:
            drawn = self._uniform.at(self._episode, environments.time, normal=False)
            if self._all_choices:
                return actors.explore_options(environments.observation, drawn, 1.0 if uniform else noise_std)
            return 2.0 * drawn - 1.0
        noise = self._noise.at(self._episode, environments.time, normal=True)
        return actors.explore(environments.observation, noise, noise_std)

    def _credit(self, rows: "_ChunkRows", index: int, stop: int) -> None:
        """Correct the rewards of an environment's running episode in the chunk's rows before row `stop`."""
        if self.environments.hindsight is not None:
            start = max(0, stop - int(self.environments.time[index]))
            part = rows.reward[index, start:stop]
            part[...] = credit_newest(self.environments, index, part, self._share)

    def _could_begin(self) -> bool:
        """Begin episodes; return whether no environment is away until the patience is at an end."""
        try:
            self._begin_episodes()
        except CancelledError:
            return False
        return True

    def _begin_episodes(self) -> None:
        """Begin an episode in every environment that has none."""
        environments = self.environments
        for index in map(int, np.flatnonzero(environments.ended | (environments.time < 0))):
            self._begin(index)

    def _begin(self, index: int) -> None:
        parts = (*self._identity, index, int(self._episode[index]) + 1)
        farm = int(stream(*parts, "farm").integers(self._config.rollout.train_farms))
        self.environments.reset(index, farm, derive(*parts, "episode"))
        self._episode[index] += 1
        if self._state is not None:
            self._state[index] = 0.0
        if self.probe is not None and index == self.probe.index:
            self.probe.record()


class _ChunkRows:
    """The rows of one chunk: environments by steps, and the final observations of episodes that ended in it.

    Arrays are [E, steps + 1, ...]; the last row of an environment holds only its observation.
    """

    def __init__(self, count: int, steps: int, team: TeamSpec, *, log_probabilities: bool, rounded: bool) -> None:
        kind = observation_type(team, rounded=rounded)
        self._rounded = kind == np.uint16
        self._observation: Seen = np.empty((count, steps + 1, team.observation_size), kind)
        self.action = np.zeros((count, steps + 1, team.action_size), np.float32)
        self.reward = np.zeros((count, steps + 1, team.agents), np.float32)
        self.log_probability = np.zeros((count, steps + 1, team.agents if log_probabilities else 0), np.float32)
        self._flag = np.zeros((count, steps + 1), np.uint8)
        self._flag[:, :steps] = TRANSITION
        self._ends: list[tuple[int, int, Seen]] = []

    def write_observation(self, step: int, observation: Float32) -> None:
        """Write the observations [E, O] before a step."""
        self._observation[:, step] = to_bits(observation) if self._rounded else observation

    def end(self, index: int, done: int, terminated: bool) -> None:
        """Mark the end of an environment's episode in its newest step, whose observations must already be written.

        Args:
            index: the environment.
            done: its steps so far.
            terminated: whether the step led to a terminal state.
        """
        self._flag[index, done - 1] |= TERMINATED if terminated else TRUNCATED
        self._ends.append((index, done, self._observation[index, done].copy()))

    def rows(self, steps: int) -> Rows:
        """Return the rows of the first steps.

        Each episode's final observation has its own row, before the next episode's first row.
        """
        self._flag[:, steps] = 0
        length = steps + 1
        count = len(self._flag) * length
        observation = self._observation[:, :length].reshape(count, -1)
        others = [a[:, :length].reshape(count, a.shape[2]) for a in (self.action, self.reward, self.log_probability)]
        flag = self._flag[:, :length].reshape(count)
        inserted = [(index * length + done, last) for index, done, last in self._ends if done < steps]
        if inserted:
            inserted.sort(key=lambda entry: entry[0])
            places = [place for place, _ in inserted]
            observation = np.insert(observation, places, np.stack([last for _, last in inserted]), axis=0)
            others = [np.insert(array, places, 0.0, axis=0) for array in others]
            flag = np.insert(flag, places, np.uint8(0))
        action, reward, log_probability = others
        return Rows(observation, action, reward, flag, log_probability if log_probability.shape[1] else None)


def run_noise_free_episodes(
    config: RunConfig,
    actors: TeamActors,
    farms: Sequence[int],
    episodes: Sequence[int],
    cancelled: Callable[[], bool] = lambda: False,
) -> tuple[Float32, NDArray[np.int64]]:
    """Run one noise-free episode on each farm.

    Args:
        config: the run.
        actors: the actors.
        farms: farm seeds.
        episodes: episode seeds, one for each farm.
        cancelled: asked before each step whether to give up.

    Returns:
        [F, T, agents] step rewards, zeros after the end of a shorter episode, and [F] the steps of each episode.

    Raises:
        CancelledError: it was given up.
    """
    with closing(make_environments(config, len(farms))) as batch:
        for index, (farm, episode) in enumerate(zip(farms, episodes, strict=True)):
            batch.reset(index, farm, episode)
        rewards: list[Float32] = []
        state = actors.initial_state(len(farms))
        while not batch.ended.all():
            if cancelled():
                raise CancelledError("the evaluation was given up, because its process ends.")
            batch.step(actors.environment_actions(batch.observation, state))
            rewards.append(batch.reward.copy())
        return np.stack(rewards, axis=1), batch.time.copy()
