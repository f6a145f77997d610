"""Collection of experience: a batch of environments stepped with the newest actors and exploration noise."""

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import RunConfig
from eia_sec.common.errors import CancelledError
from eia_sec.common.protocol.bfloat16 import Bits, to_bits
from eia_sec.common.seeds import derive, stream
from eia_sec.common.team import Float32, TeamSpec
from eia_sec.common.transitions import TERMINATED, TRANSITION, TRUNCATED, Chunk, EpisodeSummary, Rows
from eia_sec.rollout.envs.registry import make_environments
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

    A chunk is `chunk_steps` steps of every environment. An episode's farm or scenario, its seed and its noise
    depend only on (run seed, worker, start, environment, episode number), never on other processes.

    Args:
        config: the run.
        worker: the worker's name.
        start: number of this start of the worker; the same number repeats the same episodes.

    Attributes:
        environments: the batch.
        team: layout of a row.
        environment_steps: steps of all environments in the chunks that were collected.
        simulated: the same with those of the chunk that is being collected.
        probe: records one environment while somebody watches, else None; the experience does not depend on it.

    Raises:
        ConfigError: the environment does not exist or cannot be trained.
    """

    def __init__(self, config: RunConfig, worker: str, start: int) -> None:
        self._config = config
        self._identity = (config.seed, worker, start)
        count = config.rollout.environments
        by_type = config.on_policy.hindsight_shares() if config.learns_on_policy else {}
        self.environments = make_environments(config, count, any(by_type.values()))
        self.team = self.environments.team
        self._share = shares_of(self.team, by_type)
        ends = config.learns_on_policy and config.on_policy.time_limit == "terminal"
        self._shaping = RewardShaping(self.environments, config.algorithm.potential_discount, ends=ends)
        self.environment_steps = self.simulated = 0
        self.probe: StepObserver | None = None
        self._episode: NDArray[np.int64] = np.full(count, -1, np.int64)
        self._noise = RandomRows((*self._identity, "noise"), count, self.team.action_size)
        self._sampler = ActionSampler(self.team)
        self._all_choices = all(group.choices for group in self.team.groups)
        self._uniform = RandomRows((*self._identity, "uniform"), count, self.team.action_size)
        self._state: Float32 | None = None
        if config.memory_size:
            self._state = np.zeros((count, self.team.agents, config.memory_size), np.float32)
        for index in range(count):
            self._begin(index)

    def collect(
        self, actors: TeamActors, noise_std: float, uniform: bool, meanwhile: Callable[[], None] = lambda: None
    ) -> Chunk:
        """Collect one chunk.

        Args:
            actors: the actors.
            noise_std: standard deviation of the Gaussian noise on a deterministic head's action, 0..1; without meaning
                for algorithms that learn on policy, whose actions are sampled from the actors' distributions.
            uniform: draw actions uniformly instead (warm-up); without meaning for those algorithms, too.
            meanwhile: called after each step; a chunk may take many seconds. What it raises ends the chunk, and the
                collector must not collect again.

        Returns:
            The rows of all environments, one environment after the other, and the episodes that ended. Rewards in rows
            may be shaped (`eia_sec.rollout.worker.reward_shaping`); rewards of episodes are not.
        """
        environments, steps = self.environments, self._config.rollout.chunk_steps
        rows = _ChunkRows(
            len(environments.time),
            steps,
            self.team,
            log_probabilities=self._config.learns_on_policy,
            rounded=self._config.bfloat16_observations,
        )
        state = None if self._state is None else self._state.copy()
        episodes: list[EpisodeSummary] = []
        for step in range(steps):
            rows.write_observation(step, environments.observation)
            action, log_probability, adapted = self._select_actions(actors, noise_std, uniform)
            self._shaping.before_step()
            environments.step(adapted)
            self.simulated += len(environments.time)
            meanwhile()
            if self.probe is not None:
                self.probe.record()
            rows.action[:, step], rows.log_probability[:, step] = action, log_probability
            rows.reward[:, step] = self._shaping.shaped_reward()
            episodes += self._end_episodes(rows, step + 1)
        for running in range(len(environments.time)):
            self._credit(rows, running, steps)
        self.environment_steps = self.simulated
        return Chunk(replace(rows.rows(), state=state), tuple(episodes))

    def _select_actions(self, actors: TeamActors, noise_std: float, uniform: bool) -> tuple[Float32, Float32, Float32]:
        """Return actions, log-probabilities [E, agents], or [E, 0] off policy, and the actions adapted."""
        if self._config.learns_on_policy:
            return self._sample(actors)
        action = self._explore(actors, noise_std, uniform)
        return action, np.zeros((len(action), 0), np.float32), self.team.adapt(self.environments.observation, action)

    def _end_episodes(self, rows: "_ChunkRows", steps_done: int) -> list[EpisodeSummary]:
        """Close the episodes that ended in the chunk's newest step, and begin others.

        Args:
            rows: the chunk's rows.
            steps_done: its steps so far.

        Returns:
            Summaries of the episodes.
        """
        environments = self.environments
        over = [int(index) for index in np.flatnonzero(environments.ended)]
        if over or steps_done == self._config.rollout.chunk_steps:  # else the next step writes these observations
            rows.write_observation(steps_done, environments.observation)
        summaries = []
        for index in over:
            self._credit(rows, index, steps_done)
            rows.end(index, steps_done - 1, bool(environments.terminated[index]))
            summaries.append(environments.summary(index))
            self._begin(index)
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
        if uniform:
            return 2.0 * self._uniform.at(self._episode, environments.time, normal=False) - 1.0
        noise = self._noise.at(self._episode, environments.time, normal=True)
        return actors.explore(environments.observation, noise, noise_std)

    def _credit(self, rows: "_ChunkRows", index: int, stop: int) -> None:
        """Correct the rewards of an environment's running episode in the chunk's rows before row `stop`."""
        if self.environments.hindsight is not None:
            start = max(0, stop - int(self.environments.time[index]))
            part = rows.reward[index, start:stop]
            part[...] = credit_newest(self.environments, index, part, self._share)

    def _begin(self, index: int) -> None:
        self._episode[index] += 1
        if self._state is not None:
            self._state[index] = 0.0
        parts = (*self._identity, index, int(self._episode[index]))
        farm = int(stream(*parts, "farm").integers(self._config.rollout.train_farms))
        self.environments.reset(index, farm, derive(*parts, "episode"))
        if self.probe is not None and index == self.probe.index:
            self.probe.record()


class _ChunkRows:
    """The rows of one chunk: environments by steps, and the final observations of episodes that ended in it.

    Arrays are [E, steps + 1, ...]; the last row of an environment holds only its observation.
    """

    def __init__(self, count: int, steps: int, team: TeamSpec, *, log_probabilities: bool, rounded: bool) -> None:
        self._steps, self._rounded = steps, rounded
        self._observation = np.empty((count, steps + 1, team.observation_size), np.uint16 if rounded else np.float32)
        self.action = np.zeros((count, steps + 1, team.action_size), np.float32)
        self.reward = np.zeros((count, steps + 1, team.agents), np.float32)
        self.log_probability = np.zeros((count, steps + 1, team.agents if log_probabilities else 0), np.float32)
        self._flag = np.zeros((count, steps + 1), np.uint8)
        self._flag[:, :steps] = TRANSITION
        self._inserted: list[tuple[int, Float32 | Bits]] = []

    def write_observation(self, step: int, observation: Float32) -> None:
        """Write the observations [E, O] before a step."""
        self._observation[:, step] = to_bits(observation) if self._rounded else observation

    def end(self, index: int, step: int, terminated: bool) -> None:
        """Mark the end of an environment's episode in a step. The final observation must already be written."""
        self._flag[index, step] |= TERMINATED if terminated else TRUNCATED
        if step + 1 < self._steps:
            place = index * (self._steps + 1) + step + 1
            self._inserted.append((place, self._observation[index, step + 1].copy()))

    def rows(self) -> Rows:
        """Return all rows. Each episode's final observation has its own row, before the next episode's first row."""
        count = self._flag.size
        arrays = (self._observation, self.action, self.reward, self.log_probability)
        observation, *others = (array.reshape(count, array.shape[2]) for array in arrays)
        flag = self._flag.reshape(count)
        if self._inserted:
            self._inserted.sort(key=lambda entry: entry[0])
            places = [place for place, _ in self._inserted]
            observation = np.insert(observation, places, np.stack([last for _, last in self._inserted]), axis=0)
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
