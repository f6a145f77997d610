"""The training of a run, without communication: experience in, updates, actors out.

    trainer = Trainer(config, team)
    while trainer.episodes < config.episodes:
        trainer.absorb(chunk, version)
        trainer.train(trainer.updates_due())
        actors, version = trainer.actors(), trainer.next_version()

The number of updates due depends only on the counters, so a resumed run, or one in lockstep, does the same updates at
the same points.
"""

import math
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor

from common.actors import TeamActors, imitate
from common.config import RunConfig
from common.errors import SchemaError
from common.imitation import ImitationEvent
from common.seeds import stream
from common.team import TeamSpec
from common.transitions import TRANSITION, Chunk, EpisodeSummary
from learner.checkpoint.trainer_state import (
    checked_tensors,
    counter,
    current_names,
    episode_record,
    episode_summaries,
    finite,
    mapping,
    random_state,
    restored_random,
)
from learner.data.replay import Replay
from learner.data.tensor_snapshot import Frozen, whole
from learner.diagnostics import RETURN_PERIOD, SHARE, RunningDiagnostics, newest_returns
from learner.engine import Diagnostics, Engine
from learner.networks.device import usable_device

COUNTERS = ("environment_steps", "updates", "episodes", "version", "events", "evaluation_steps")
RECENT_EPISODES = 100
DIAGNOSTIC_PERIOD = 16
"""Every this many updates, an update returns diagnostics."""


class Trainer:
    """Networks, replay and counters of one run.

    Args:
        config: the run.
        team: the layout of the team.

    Raises:
        ConfigError: when the configured device does not exist.

    Attributes:
        environment_steps: environment steps absorbed.
        updates: updates done.
        episodes: training episodes finished.
        version: number of the newest published parameters; 0 before the first.
        events: imitation events applied.
        evaluation_steps: environment steps that these events' evaluations took; part of the run's budget (A3).
        recent: the newest finished episodes.
        diagnostics: running means of the updates' diagnostics.
    """

    def __init__(self, config: RunConfig, team: TeamSpec) -> None:
        self.config, self.team = config, team
        usable_device(config.learner.device)
        self.engine = Engine(config.off_policy, team, config.seed, config.learner.device)
        algorithm, device = config.off_policy, config.learner.device
        self.replay = Replay(team, config.replay.capacity, device, steps=algorithm.n_step, discount=algorithm.discount)
        self.random = stream(config.seed, "replay")
        self.environment_steps = self.updates = self.episodes = self.version = self.events = 0
        self.evaluation_steps = 0
        self.recent: deque[EpisodeSummary] = deque(maxlen=RECENT_EPISODES)
        self.diagnostics = RunningDiagnostics(team, config.learner.device)
        self._age = self._oldest = 0.0

    def absorb(self, chunk: Chunk, version: int = 0, source: str = "", number: int = 0) -> None:
        """Add a chunk to replay and count it.

        Args:
            chunk: rows that fit the team, and the episodes that ended in them.
            version: policy version that acted in it.
            source: name of the worker's start that made it; empty if no later chunk continues its trajectories.
            number: number of the chunk among those of the source.
        """
        self.replay.add(chunk.rows, version, source, number)
        follows = (chunk.rows.flag & TRANSITION) != 0
        self.engine.observe(chunk.rows.observation[follows], chunk.rows.reward[follows])
        self.environment_steps += chunk.rows.steps
        self.episodes += len(chunk.episodes)
        self.recent.extend(chunk.episodes)

    def updates_due(self) -> int:
        """Return floor(updates_per_step * steps after warm-up) less the updates done; 0 while replay holds no batch."""
        replay = self.config.replay
        if self.replay.transitions < self.config.algorithm.batch:
            return 0
        return math.floor(replay.updates_per_step * max(0, self.environment_steps - replay.warmup_steps)) - self.updates

    def leads(self) -> bool:
        """Return whether collection leads updates by more than the configured slack, so that workers must wait."""
        replay = self.config.replay
        if replay.updates_per_step == 0:
            return False
        return self.updates_due() / replay.updates_per_step > replay.slack_steps

    def train(self, updates: int) -> None:
        """Do this many updates."""
        with _flushed_denormals():
            for _ in range(updates):
                batch = self.replay.sample(self.config.algorithm.batch, self.random)
                wanted = self.updates % DIAGNOSTIC_PERIOD == 0
                diagnostics = self.engine.update(batch, diagnostics=wanted)
                if diagnostics is not None:
                    self._note(diagnostics)
                self.updates += 1

    def snapshot(self) -> tuple[dict[str, Tensor | Frozen], dict[str, Any]]:
        """Return the state from which `restore` continues bit-equal: tensors, and values that JSON can hold.

        It is the state at this instant, whatever training does afterwards. The large tensors are copied only when read.
        """
        rows, counts = self.replay.snapshot()
        tensors: dict[str, Tensor | Frozen] = {f"replay.{name}": tensor for name, tensor in rows.items()}
        tensors |= {f"engine.{name}": tensor.clone().cpu() for name, tensor in self.engine.tensors().items()}
        tensors |= self.diagnostics.tensors()
        plain: dict[str, Any] = {name: getattr(self, name) for name in COUNTERS}
        plain |= {
            "diagnostic_updates": self.diagnostics.updates,
            "comparisons": self.diagnostics.comparisons,
            "sample_age": self._age,
            "sample_age_most": self._oldest,
            "random": random_state(self.random),
            "update_noise": random_state(self.engine.random),
            "recent": [episode_record(episode) for episode in self.recent],
            "replay": counts,
        }
        return tensors, plain

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Return the `snapshot` with every tensor read."""
        tensors, plain = self.snapshot()
        return {name: whole(tensor) for name, tensor in tensors.items()}, plain

    def restore(self, tensors: dict[str, Tensor], state: dict[str, Any]) -> None:
        """Continue from `state`; if any part does not fit, change nothing.

        Raises:
            CheckpointError: when something is missing or does not fit the configuration.
        """
        tensors, state = current_names(tensors, state)
        engine = self.engine
        own = {f"engine.{name}": tensor for name, tensor in engine.tensors().items()}
        found, means = checked_tensors(own, tensors), self.diagnostics.kept(tensors)
        names = (*COUNTERS, "diagnostic_updates", "comparisons")
        counts = {name: counter(state, name) for name in names}
        random, noise = restored_random(state.get("random")), restored_random(state.get("update_noise"))
        recent = episode_summaries(state.get("recent"))
        age, oldest = finite(state, "sample_age"), finite(state, "sample_age_most")
        prefix = "replay."
        rows = {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}
        self.replay.restore(rows, mapping(state, "replay"))
        for name, tensor in own.items():
            tensor.copy_(found[name])
        for name in COUNTERS:
            setattr(self, name, counts[name])
        engine.random = noise
        engine.restored()
        self.diagnostics.means = means
        self.diagnostics.updates, self.diagnostics.comparisons = counts["diagnostic_updates"], counts["comparisons"]
        self._age, self._oldest, self.random = age, oldest, random
        self.recent = deque(recent, maxlen=RECENT_EPISODES)

    def _note(self, diagnostics: Diagnostics) -> None:
        share = SHARE if self.diagnostics.updates else 1.0
        self._age += share * (self.version - self.replay.drawn_version - self._age)
        self._oldest += share * (self.version - self.replay.drawn_oldest - self._oldest)
        self.diagnostics.note(diagnostics)
        if self.updates % RETURN_PERIOD == 0:
            discount, scale = self.config.algorithm.discount, self.config.algorithm.reward_scale
            returns, chosen = newest_returns(self.replay, self.replay.drawn_places, discount)
            self.diagnostics.compare(diagnostics, self.engine.normalisation.rewarded(returns) * scale, chosen)

    def actors(self) -> TeamActors:
        """Return a copy of all actors."""
        return self.engine.actors()

    def next_version(self) -> int:
        """Increment the version and return it; the present actors are published under it."""
        self.version += 1
        most = self.config.replay.max_age_versions
        if 0 < most < self.version:
            self.replay.drop_before(self.version - most)
        return self.version

    def imitate(self, event: ImitationEvent) -> bool:
        """Apply an imitation event to the actors, eq. (soft), unless it has been applied already.

        Adam's moments do not change.

        Returns:
            Whether this call applied it.

        Raises:
            SchemaError: when it does not fit the team, or an event before it is missing.
        """
        event.check(self.team)
        if event.event <= self.events:
            return False
        if event.event > self.events + 1:
            raise SchemaError(f"imitation event {event.event} cannot follow event {self.events}.")
        flat = self.engine.export_actors()
        for parameters, elite in zip(flat, event.elites, strict=True):
            imitate(parameters, elite, event.rate)
        self.engine.load_actors(flat)
        self.events += 1
        self.evaluation_steps += event.evaluation_steps
        return True

    def statistics(self) -> dict[str, float]:
        """Return running means of the diagnostics for each type, and statistics of replay."""
        result = self.diagnostics.by_type()
        result["replay_rows"] = float(self.replay.rows)
        result["replay_occupancy"] = self.replay.occupancy
        result["replay_dropped"] = float(self.replay.dropped)
        result["sample_age_versions"] = self._age
        result["sample_age_most_versions"] = self._oldest
        result["samples_per_insert"] = self.replay.drawn / max(1, self.environment_steps)
        if self.replay.reuse is not None:
            result["replay_reuse"] = self.replay.reuse
        return result


@contextmanager
def _flushed_denormals() -> Iterator[None]:
    """Flush numbers below 1e-38 to 0 in this block: moments of inactive units decay into that range and are slow."""
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)
