"""What is no protocol in a simulated run: an environment that counts, and a learner whose networks are a counter.

Every row bears the number of its chunk, so that whatever reaches a trainer can be traced to who made it.
"""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import from_toml
from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.imitation import ImitationEvent
from eia_sec.common.protocol.bfloat16 import to_bits
from eia_sec.common.team import Float32, GroupSpec, TeamSpec
from eia_sec.common.transitions import TRANSITION, TRUNCATED, Chunk, EpisodeSummary, Rows
from eia_sec.learner.checkpoint.tensor_snapshot import Frozen
from eia_sec.learner.checkpoint.trainer_state import counter
from eia_sec.learner.trainer import Trainer
from tests.simulation.world import Process, World

TEAM = TeamSpec((GroupSpec("one", 2, 3, 2),))
EPISODE = 8
"""Steps of every episode."""
ENVIRONMENT = EnvironmentSpec(TEAM, (EPISODE, EPISODE))
HIDDEN = 4
RATE = 0.25
"""Updates for each environment step, off policy."""
LEAD = 60
"""Steps by which collection may be ahead of updates, off policy."""

Identity = tuple[str, int, int]
"""Worker, start and number of a chunk."""

OFF_POLICY = """
[algorithm]
name = "eia-sec"
batch = 4
hidden = 4
[replay]
capacity = 256
intake_chunks = 6
[exploration]
"""
ON_POLICY = """
[algorithm]
name = "eia-ppo"
hidden = 4
iteration_steps = 24
"""
SHARED = """
episodes = 20
[rollout]
environments = 1
chunk_steps = 4
spool_chunks = 3
train_farms = 4
[elite]
enabled = true
cycle = 4
cycle_growth = 1.0
rate_decay = 0.9
farms = 2
[learner]
checkpoint_seconds = 2.0
publish_seconds = 0.5
"""


def configuration(*, on_policy: bool, seed: int) -> RunConfig:
    """Return the configuration of a simulated run."""
    return replace(from_toml(SHARED + (ON_POLICY if on_policy else OFF_POLICY), RunConfig()), seed=seed)


class ToyEnvironments:
    """Collects chunks of rows that bear their number, and takes simulated time for it; in a `Collector`'s place.

    Args:
        world: the clock.
        process: who collects.
        seconds: how long a chunk takes.
        on_policy: whether rows have log-probabilities.
        produced: where the chunks are noted, by (worker, start, number).
    """

    def __init__(
        self,
        world: World,
        process: Process,
        source: tuple[str, int],
        seconds: float,
        produced: dict[Identity, Chunk],
        *,
        on_policy: bool,
    ) -> None:
        self._world, self._process, self._seconds, self._source = world, process, seconds, source
        self._produced, self._on_policy = produced, on_policy
        self.team, self.chunk_steps = TEAM, 4
        self.environments = SimpleNamespace(spec=ENVIRONMENT, time=np.zeros(1, np.int64))
        self.environment_steps = self.simulated = 0
        self.probe, self.alarm = None, ""
        self._number = self._since = self._episodes = 0

    def collect(self, actors: TeamActors, noise_std: float, uniform: bool, goes_on: Callable[[], bool]) -> Chunk:
        """Return the next chunk."""
        flags: list[int] = []
        episodes = []
        self._number += 1
        while sum(flag & TRANSITION for flag in flags) < self.chunk_steps:
            self.simulated += 1
            self._since += 1
            over = self._since == EPISODE
            flags.append(TRANSITION | (TRUNCATED if over else 0))
            if over:
                self._episodes += 1
                episodes.append(EpisodeSummary(0, self._episodes, EPISODE, (1.0,) * TEAM.agents, {}))
                self._since = 0
                flags.append(0)
            if not goes_on():
                break
        if flags[-1]:
            flags.append(0)
        count = len(flags)
        observation = np.full((count, TEAM.observation_size), self._number, np.float32)
        action = np.full((count, TEAM.action_size), 0.5, np.float32)
        reward = np.full((count, TEAM.agents), 0.5, np.float32)
        log_probability = np.full((count, TEAM.agents), -1.0, np.float32) if self._on_policy else None
        seen = to_bits(observation) if self._on_policy else observation
        chunk = Chunk(Rows(seen, action, reward, np.array(flags, np.uint8), log_probability), tuple(episodes))
        self.environment_steps = self.simulated
        self._process.busy_until = self._world.now + self._seconds * self._world.draw.uniform(0.5, 1.5)
        self._produced[(*self._source, self._number)] = chunk
        return chunk


def evaluate(
    config: RunConfig, actors: TeamActors, farms: tuple[int, ...], episodes: tuple[int, ...], cancelled: Any
) -> tuple[Float32, np.ndarray]:
    """Return rewards from which the elite follows; in the place of `run_noise_free_episodes`."""
    mean = np.array([float(actors.flat[0][agent].mean()) for agent in range(TEAM.agents)], np.float32)
    rewards = np.stack([np.full((2, TEAM.agents), farm % 3, np.float32) * mean + mean for farm in farms])
    return rewards, np.full(len(farms), 2, np.int64)


class ToyTrainer(Trainer):
    """A trainer whose updates add a little to the actors; what it took in is part of its checkpoints.

    Attributes:
        absorbed: the chunks in it, in order, each with the version that it bore.
        imitated: the numbers of the events in it.
        by_imitation: versions that differ from the ones before by an imitation event alone.
        iterations: iterations done (on policy).
        held, following: steps in the running iteration and in the next one.
        process: who trains.
    """

    def __init__(self, config: RunConfig, team: TeamSpec, world: World, on_absorbed: Callable[..., None]) -> None:
        super().__init__(config, team)
        assert world.current is not None
        self._world, self.process, self._on_absorbed = world, world.current, on_absorbed
        self._on_policy = config.learns_on_policy
        self.publishes_at_once = self._on_policy  # type: ignore[misc]  # a class attribute of the product's trainers
        self.absorbed: list[tuple[str, int, int]] = []
        self.imitated: list[int] = []
        self.by_imitation: list[int] = []
        self._published = -1
        self.iterations = self.held = self.following = self._left = 0
        self._flat = TeamActors.initial(team, HIDDEN, config.seed, per_type=False).flat

    def take_in(self, chunk: Chunk, version: int, source: str, number: int) -> None:
        """Note the chunk."""
        self._on_absorbed(self, chunk, version, source, number)
        self.absorbed.append((source, number, version))
        if self.updates_due() and self._on_policy:
            self.following += chunk.rows.steps
        else:
            self.held += chunk.rows.steps

    @property
    def changes(self) -> int:
        """Whatever changes the actors that may be published."""
        return (self.iterations if self._on_policy else self.updates) + self.events + self.exploits

    def retune(self) -> None:
        """Nothing here depends on hyperparameters."""

    @property
    def between_iterations(self) -> bool:
        """Whether no iteration is halfway done."""
        return not self._left

    @property
    def iteration(self) -> tuple[int, int] | None:
        """The iteration that the next chunks enter, and the steps that it still takes in."""
        if not self._on_policy:
            return None
        whole = self.config.on_policy.iteration_steps
        return (
            (self.iterations + 1, whole - self.following)
            if self.updates_due()
            else (self.iterations, whole - self.held)
        )

    def updates_due(self) -> int:
        """Return the updates that are due."""
        if self._on_policy:
            return self._left or (2 if self.held >= self.config.on_policy.iteration_steps else 0)
        return int(self.environment_steps * RATE) - self.updates

    def leads(self) -> bool:
        """Return whether collection is ahead of updates."""
        return self.updates_due() > 0 if self._on_policy else self.environment_steps - self.updates / RATE >= LEAD

    def train(self, updates: int) -> None:
        """Do updates, which take simulated time."""
        for _ in range(min(updates, self.updates_due())):
            if self._on_policy:
                self._left = self._left or 2
                self._left -= 1
            self.updates += 1
            (flat,) = self._flat
            flat += np.float32(1e-3) * np.arange(1, len(flat) + 1, dtype=np.float32)[:, None]
            if self._on_policy and not self._left:
                self.iterations, self.held, self.following = self.iterations + 1, self.following, 0
        self.process.busy_until = self._world.now + 0.02 * updates * self._world.draw.random()

    def actors(self) -> TeamActors:
        """Return a copy of the actors."""
        return TeamActors(self.team, HIDDEN, tuple(flat.copy() for flat in self._flat))

    def load_actors(self, flat: tuple[Float32, ...]) -> None:
        """Replace the actors."""
        self._flat = tuple(part.copy() for part in flat)

    def imitate(self, event: ImitationEvent) -> bool:
        """Note the event if it is applied."""
        applied = super().imitate(event)
        if applied:
            self.imitated.append(event.event)
        return applied

    def next_version(self) -> int:
        """Note what the new version differs by."""
        version = super().next_version()
        if self.iterations == self._published:
            self.by_imitation.append(version)
        self._published = self.iterations
        return version

    def statistics(self) -> dict[str, float]:
        """Return nothing."""
        return {}

    def agent_statistics(self) -> dict[str, float]:
        """Return nothing."""
        return {}

    def largest_checkpoint(self) -> int:
        """Return a bound."""
        return 2**20

    def snapshot_parts(self) -> tuple[dict[str, Tensor | Frozen], dict[str, Any]]:
        """Return the actors, and what was taken in."""
        tensors: dict[str, Tensor | Frozen] = {
            f"actors.{index}": torch.from_numpy(flat.copy()) for index, flat in enumerate(self._flat)
        }
        counts = {name: getattr(self, name) for name in ("iterations", "held", "following", "_left")}
        return tensors, {**counts, "absorbed": list(self.absorbed), "imitated": list(self.imitated)}

    def restore_parts(self, tensors: dict[str, Tensor], state: dict[str, Any]) -> None:
        """Continue from them."""
        self._flat = tuple(tensors[f"actors.{index}"].numpy().copy() for index in range(len(self._flat)))
        for name in ("iterations", "held", "following", "_left"):
            setattr(self, name, counter(state, name))
        self.absorbed = [(source, number, version) for source, number, version in state["absorbed"]]
        self.imitated = list(state["imitated"])
