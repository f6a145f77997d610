"""Training from a replay buffer: the trainer of all algorithms that learn off policy."""

import math
from typing import Any, Final

from torch import Tensor

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import RunConfig
from eia_sec.common.seeds import stream
from eia_sec.common.team import Float32, TeamSpec
from eia_sec.common.transitions import Chunk
from eia_sec.learner.checkpoint.tensor_snapshot import Frozen
from eia_sec.learner.checkpoint.trainer_state import (
    checked_tensors,
    counter,
    finite,
    mapping,
    random_state,
    require_moments,
    restored_random,
)
from eia_sec.learner.off_policy.diagnostics import RETURN_PERIOD, SHARE, RunningDiagnostics, newest_returns
from eia_sec.learner.off_policy.engine import Diagnostics, Engine
from eia_sec.learner.off_policy.replay import LARGE, SMALL, Replay
from eia_sec.learner.trainer import Trainer, flushed_denormals

DIAGNOSTIC_PERIOD: Final = 16
"""Every this many updates, an update returns diagnostics."""


class OffPolicyTrainer(Trainer):
    """Networks, replay and counters of one run.

    Args:
        config: the run.
        team: the layout of the team.

    Raises:
        ConfigError: when the configured device does not exist.

    Attributes:
        engine: the networks and their updates.
        replay: the rows.
        random: the generator that draws batches.
        diagnostics: running means of the updates' diagnostics.
    """

    def __init__(self, config: RunConfig, team: TeamSpec) -> None:
        super().__init__(config, team)
        algorithm, device = config.off_policy, config.learner.device
        self.engine = Engine(algorithm, team, config.network_seed, device)
        self.replay = Replay(team, config.replay.capacity, device)
        self.random = stream(config.seed, "replay")
        self.diagnostics = RunningDiagnostics(team, device)
        self._batch = algorithm.batch
        self._age = self._oldest = 0.0

    def take_in(self, chunk: Chunk, version: int, source: str, number: int) -> None:
        """Add the rows to replay."""
        self.replay.add(chunk.rows, version, source, number)

    def updates_due(self) -> int:
        """Return floor(updates_per_step * steps after warm-up) less the updates done; 0 while replay holds no batch."""
        replay = self.config.replay
        if self.replay.transitions < self._batch:
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
        with flushed_denormals():
            for _ in range(updates):
                batch = self.replay.sample(self._batch, self.random)
                wanted = self.updates % DIAGNOSTIC_PERIOD == 0
                diagnostics = self.engine.update(batch, diagnostics=wanted)
                if diagnostics is not None:
                    self._note(diagnostics)
                self.updates += 1

    def _note(self, diagnostics: Diagnostics) -> None:
        share = SHARE if self.diagnostics.updates else 1.0
        self._age += share * (self.version - self.replay.drawn_version - self._age)
        self._oldest += share * (self.version - self.replay.drawn_oldest - self._oldest)
        self.diagnostics.note(diagnostics)
        if self.updates % RETURN_PERIOD == 0:
            discount, scale = self.config.algorithm.discount, self.config.algorithm.reward_scale
            returns, chosen = newest_returns(self.replay, self.replay.drawn_places, discount)
            self.diagnostics.compare(diagnostics, returns * scale, chosen)

    def actors(self) -> TeamActors:
        """Return a copy of all actors."""
        return self.engine.actors()

    def load_actors(self, flat: tuple[Float32, ...]) -> None:
        """Replace the actors' parameters, [n_v, P_v] for each type."""
        self.engine.algorithm.actors.load(flat)

    def retune(self) -> None:
        """See `Trainer`."""
        self.engine.retune(self.config.off_policy)

    def next_version(self) -> int:
        """Increment the version and return it; rows that are now too old are no longer drawn."""
        version = super().next_version()
        most = self.config.replay.max_age_versions
        if 0 < most < version:
            self.replay.drop_before(version - most)
        return version

    def snapshot_parts(self) -> tuple[dict[str, Tensor | Frozen], dict[str, Any]]:
        """Return replay, networks, diagnostics and random states."""
        rows, counts = self.replay.snapshot()
        tensors: dict[str, Tensor | Frozen] = {f"replay.{name}": tensor for name, tensor in rows.items()}
        tensors |= {f"engine.{name}": tensor.clone().cpu() for name, tensor in self.engine.tensors().items()}
        tensors |= self.diagnostics.tensors()
        plain: dict[str, Any] = {
            "diagnostic_updates": self.diagnostics.updates,
            "comparisons": self.diagnostics.comparisons,
            "sample_age": self._age,
            "sample_age_most": self._oldest,
            "random": random_state(self.random),
            "update_noise": random_state(self.engine.random),
            "replay": counts,
        }
        return tensors, plain

    def restore_parts(self, tensors: dict[str, Tensor], state: dict[str, Any]) -> None:
        """Continue from `snapshot_parts`."""
        engine = self.engine
        own = {f"engine.{name}": tensor for name, tensor in engine.tensors().items()}
        found, means = checked_tensors(own, tensors), self.diagnostics.kept(tensors)
        require_moments(found)
        updates, comparisons = counter(state, "diagnostic_updates"), counter(state, "comparisons")
        random, noise = restored_random(state.get("random")), restored_random(state.get("update_noise"))
        age, oldest = finite(state, "sample_age"), finite(state, "sample_age_most")
        prefix = "replay."
        rows = {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}
        self.replay.restore(rows, mapping(state, "replay"))
        for name, tensor in own.items():
            tensor.copy_(found[name])
        engine.random = noise
        self.diagnostics.means = means
        self.diagnostics.updates, self.diagnostics.comparisons = updates, comparisons
        self._age, self._oldest, self.random = age, oldest, random

    def largest_checkpoint(self) -> int:
        """Return the bytes of the networks and of a full replay."""
        networks = sum(tensor.nbytes for tensor in self.engine.tensors().values())
        rows = sum(getattr(self.replay, name).nbytes for name in (*LARGE, *SMALL))
        return int(networks + rows + 8 * self.replay.capacity)

    def statistics(self) -> dict[str, float]:
        """Return running means of the diagnostics for each type, and statistics of replay."""
        result = self.diagnostics.by_type()
        result["learning_rate"] = self.config.algorithm.actor_rate
        result["replay_rows"] = float(self.replay.rows)
        result["replay_occupancy"] = self.replay.occupancy
        result["replay_dropped"] = float(self.replay.dropped)
        result["sample_age_versions"] = self._age
        result["sample_age_most_versions"] = self._oldest
        result["samples_per_insert"] = self.replay.drawn / max(1, self.environment_steps)
        if self.replay.reuse is not None:
            result["replay_reuse"] = self.replay.reuse
        return result

    def agent_statistics(self) -> dict[str, float]:
        """Return each agent's running means of the diagnostics."""
        return self.diagnostics.by_agent()
