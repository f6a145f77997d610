"""Collecting experience: a batch of farms stepped with the present actors and exploration noise."""

from collections.abc import Sequence

import numpy as np

from common.actors import ActorBank
from common.config import RunConfig
from common.seeds import derive, stream
from common.team import Float32
from common.transitions import TRANSITION, TRUNCATED, Chunk, EpisodeSummary, Rows
from rollout.farms import FarmBatch


class Collector:
    """One worker's farms.

    All environments of the batch run in step, so a chunk is a rectangle of environments by steps; it ends where the
    episodes end. Which farm an episode is flown on, its seed and its noise follow from (run seed, worker, start,
    environment, number of the episode), never from what other processes do.

    Args:
        config: the run.
        worker: the worker's name.
        start: distinguishes the starts of a worker of this name; a fixed number repeats the same episodes.
    """

    def __init__(self, config: RunConfig, worker: str, start: int) -> None:
        self._config = config
        self._identity = (config.seed, worker, start)
        self.farms = FarmBatch(config.farm, config.rollout.environments)
        self.team = self.farms.team
        self.environment_steps = 0
        self._number = 0
        self._noise: Float32
        self._uniform: Float32
        self._begin()

    def collect(self, bank: ActorBank, deviation: float, uniform: bool) -> Chunk:
        """Fly one chunk.

        Args:
            bank: the actors.
            deviation: standard deviation of the Gaussian noise on the action, 0..1.
            uniform: draw actions uniformly instead (warm-up).

        Returns:
            Rows of all environments, each environment's segment after the other, and the episodes that ended.
        """
        farms, world = self.farms, self._config.farm.world
        first = int(farms.time[0])
        steps = min(self._config.rollout.chunk_steps, world.steps - first)
        count = farms.observation.shape[0]
        observation = np.empty((count, steps + 1, self.team.observation_size), np.float32)
        action = np.zeros((count, steps + 1, self.team.action_size), np.float32)
        reward = np.zeros((count, steps + 1, self.team.agents), np.float32)
        flag = np.zeros((count, steps + 1), np.uint8)
        flag[:, :steps] = TRANSITION
        for step in range(steps):
            observation[:, step] = farms.observation
            if uniform:
                action[:, step] = self._uniform[:, first + step]
            else:
                noisy = bank.act(farms.observation) + np.float32(deviation) * self._noise[:, first + step]
                np.clip(noisy, -1.0, 1.0, out=action[:, step])
            farms.step(np.ascontiguousarray(action[:, step]))
            reward[:, step] = farms.reward
        observation[:, steps] = farms.observation
        self.environment_steps += count * steps
        episodes = self._finish(flag, steps) if first + steps == world.steps else ()
        rows = count * (steps + 1)
        return Chunk(
            Rows(observation.reshape(rows, -1), action.reshape(rows, -1), reward.reshape(rows, -1), flag.reshape(rows)),
            episodes,
        )

    def _finish(self, flag: np.ndarray, steps: int) -> tuple[EpisodeSummary, ...]:
        flag[:, steps - 1] |= TRUNCATED
        episodes = tuple(self.farms.summary(index) for index in range(flag.shape[0]))
        self._begin()
        return episodes

    def _begin(self) -> None:
        count = self._config.rollout.environments
        shape = (self._config.farm.world.steps, self.team.action_size)
        noise, uniform = [], []
        for index in range(count):
            parts = (*self._identity, index, self._number)
            farm = int(stream(*parts, "farm").integers(self._config.rollout.train_farms))
            self.farms.reset(index, farm, derive(*parts, "episode"))
            noise.append(stream(*parts, "noise").standard_normal(shape, np.float32))
            uniform.append(stream(*parts, "uniform").uniform(-1.0, 1.0, shape).astype(np.float32))
        self._noise, self._uniform = np.stack(noise), np.stack(uniform)
        self._number += 1


def fly_noise_free(config: RunConfig, bank: ActorBank, farms: Sequence[int], episodes: Sequence[int]) -> Float32:
    """Fly one noise-free episode on each farm.

    Args:
        config: the run.
        bank: the actors.
        farms: farm seeds.
        episodes: episode seeds, one for each farm.

    Returns:
        [F, T, agents] step rewards.
    """
    batch = FarmBatch(config.farm, len(farms))
    for index, (farm, episode) in enumerate(zip(farms, episodes, strict=True)):
        batch.reset(index, farm, episode)
    reward = np.empty((len(farms), config.farm.world.steps, batch.team.agents), np.float32)
    for step in range(config.farm.world.steps):
        batch.step(bank.act(batch.observation))
        reward[:, step] = batch.reward
    return reward
