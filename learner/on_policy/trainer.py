"""Training on policy: the trainer of IPPO, MAPPO and EIA-SEC's on-policy form.

An iteration takes in `iteration_steps` environment steps, then does all its updates, then forgets the steps. While it
updates, workers already fly for the next iteration with the policy that they have; `max_lag_versions` says how old the
policy of a chunk may be when it is learned from. A chunk that enters the trainer meanwhile, as while a learner drains,
belongs to the next iteration.
"""

from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import RunConfig
from eia_sec.common.errors import CheckpointError
from eia_sec.common.log import log
from eia_sec.common.reward_sums import RewardSums
from eia_sec.common.seeds import stream
from eia_sec.common.team import Float32, TeamSpec
from eia_sec.common.transitions import Chunk, observation_type
from eia_sec.learner.checkpoint.tensor_snapshot import Frozen
from eia_sec.learner.checkpoint.trainer_state import (
    checked_tensors,
    counter,
    finite,
    random_state,
    require_moments,
    restored_random,
)
from eia_sec.learner.group.process_group import ProcessGroup
from eia_sec.learner.group.updates import LeadingUpdates
from eia_sec.learner.intake.limits import DRAINED_CHUNKS
from eia_sec.learner.on_policy.experience import Experience
from eia_sec.learner.on_policy.normalisation import require_scales
from eia_sec.learner.on_policy.updates import Updates, require_one_count
from eia_sec.learner.trainer import Trainer, flushed_denormals

NETWORKS = "networks."
STATE = "iteration_state."
ITERATION, FOLLOWING = "iteration", "following"
"""Prefixes of names in a checkpoint."""
COUNTS = ("iterations", "iteration_steps", "iteration_lag", "following_steps", "following_lag", "epochs_left")
ROW_BYTES = 32
"""Bytes of a row besides its observation, action, reward and log-probability, an upper bound."""


class OnPolicyTrainer(Trainer):
    """Networks, the running iteration and counters of one run.

    Args:
        config: the run.
        team: the layout of the team.
        group: the learners that make the updates together, which this one leads; None for this one alone.

    Attributes:
        iterations: iterations done.
        experience: rows of the running iteration.
        following: rows of the next iteration, which came while updates of the running one were due.
    """

    publishes_at_once: ClassVar[bool] = True
    burst: ClassVar[int] = 1

    def __init__(self, config: RunConfig, team: TeamSpec, group: ProcessGroup | None = None) -> None:
        super().__init__(config, team)
        self._algorithm = config.on_policy
        self.separate_since = None if self._algorithm.shared else 0
        arguments = self._algorithm, team, config.network_seed, config.learner
        self._updates = Updates(*arguments) if group is None else LeadingUpdates(*arguments, group)
        self.random = stream(config.seed, "minibatches")
        self.experience, self.following = Experience(), Experience()
        self.iterations = 0
        self._pending: list[NDArray[np.int64]] = []
        self._epochs_left = 0
        self._lag = 0.0

    def take_in(self, chunk: Chunk, version: int, source: str, number: int) -> None:
        """Add the rows to the running iteration, or to the next one while updates are due."""
        experience = self.following if self.updates_due() else self.experience
        experience.add(chunk, max(0, self.version - version))

    @property
    def changes(self) -> int:
        """Iterations and imitations; actors in the middle of an iteration are not published."""
        return self.iterations + self.events + self.exploits

    @property
    def iteration(self) -> tuple[int, int]:
        """The iteration that the next chunks enter, and the steps that it still takes in."""
        if self.updates_due():
            return self.iterations + 1, self._algorithm.iteration_steps - self.following.steps
        return self.iterations, self._algorithm.iteration_steps - self.experience.steps

    @property
    def between_iterations(self) -> bool:
        """Whether no iteration's updates are halfway done; their ratios are against the policy at its start."""
        return not self._epochs_left

    def updates_due(self) -> int:
        """Return the updates left in the running iteration; 0 while it still collects."""
        if self._epochs_left:
            return len(self._pending) + (self._epochs_left - 1) * self._per_epoch
        return self._algorithm.epochs * self._per_epoch if self._is_full else 0

    @property
    def _is_full(self) -> bool:
        return self.experience.steps >= self._algorithm.iteration_steps

    @property
    def _per_epoch(self) -> int:
        return max(1, round(self.experience.steps / self._algorithm.minibatch_steps))

    def leads(self) -> bool:
        """Return whether an iteration's updates are due; chunks then wait for the next iteration."""
        return self.updates_due() > 0

    def train(self, updates: int) -> None:
        """Do this many updates of the running iteration."""
        with flushed_denormals():
            for _ in range(min(updates, self.updates_due())):
                self._update()

    def _update(self) -> None:
        if not self._epochs_left:
            self._updates.begin(self.experience.rows(), self.environment_steps - self.following.steps)
            self._epochs_left = self._algorithm.epochs
            self._shuffle()
        self._updates.update(self._pending.pop(), self.progress)
        self.updates += 1
        if self._pending:
            return
        self._updates.end_epoch()
        self._epochs_left -= 1
        if self._epochs_left:
            self._shuffle()
        else:
            self._end_iteration()

    def _shuffle(self) -> None:
        self._pending = self._updates.minibatches(self.experience.rows(), self.random)[::-1]

    def _end_iteration(self) -> None:
        self._lag = self.experience.lag / self.experience.steps
        self._updates.diagnostics.end()
        self._updates.end()
        self.experience, self.following = self.following, Experience()
        self.iterations += 1
        if self.separate_since is None and self._algorithm.shared_until <= self.progress < 1.0:
            self._updates, self.separate_since = self._updates.separated(), self.episodes
            self.rewards = RewardSums.none(self.team.agents)
            log(f"agents have actors of their own from episode {self.episodes} on.")

    def actors(self) -> TeamActors:
        """Return a copy of all actors."""
        return self._updates.policies.actors()

    def load_actors(self, flat: tuple[Float32, ...]) -> None:
        """Replace the actors' parameters, [n_v or 1, P_v] for each type."""
        self._updates.policies.load(flat)

    def retune(self) -> None:
        """See `Trainer`."""
        self._algorithm = self.config.on_policy
        self._updates.retune(self._algorithm)

    def snapshot_parts(self) -> tuple[dict[str, Tensor | Frozen], dict[str, Any]]:
        """Return networks, optimiser, the running iteration and the random state."""
        tensors: dict[str, Tensor | Frozen] = {
            **self.experience.tensors(ITERATION),
            **self.following.tensors(FOLLOWING),
        }
        tensors |= {f"{NETWORKS}{name}": t.clone().cpu() for name, t in self._updates.network_tensors()}
        tensors |= {f"{STATE}{name}": t.cpu() for name, t in self._updates.iteration_tensors().items()}
        if self._pending:
            tensors[f"{STATE}pending"] = torch.from_numpy(np.concatenate(self._pending))
        plain: dict[str, Any] = {
            "iterations": self.iterations,
            "iteration_steps": self.experience.steps,
            "iteration_lag": self.experience.lag,
            "following_steps": self.following.steps,
            "following_lag": self.following.lag,
            "sample_age": self._lag,
            "epochs_left": self._epochs_left,
            "pending": [len(places) for places in self._pending],
            "stopped": [int(stopped) for stopped in self._updates.stopped],
            "diagnostics": self._updates.diagnostics.state(),
            "random": random_state(self.random),
        }
        return tensors, plain

    def restore_parts(self, tensors: dict[str, Tensor], state: dict[str, Any]) -> None:
        """Continue from `snapshot_parts`."""
        separate = self._algorithm.shared and state.get("separate_since") is not None
        updates = self._updates.separated() if separate else self._updates
        own = {f"{NETWORKS}{name}": tensor for name, tensor in updates.network_tensors()}
        found = checked_tensors(own, tensors)
        require_moments(found)
        require_one_count(found)
        require_scales(found)
        counts = {name: counter(state, name) for name in COUNTS}
        random, lag = restored_random(state.get("random")), finite(state, "sample_age")
        experience, following = (
            Experience.restored(
                *(self.team, self._algorithm, tensors, prefix), counts[f"{prefix}_steps"], counts[f"{prefix}_lag"]
            )
            for prefix in (ITERATION, FOLLOWING)
        )
        running = self._running(updates, tensors, state, experience, counts["epochs_left"])
        updates.diagnostics.restore(state.get("diagnostics"))
        with torch.no_grad():
            for name, tensor in own.items():
                tensor.copy_(found[name])
        self._updates = updates
        self.iterations, self._epochs_left, self._lag = counts["iterations"], counts["epochs_left"], lag
        self.experience, self.following, self.random, self._pending = experience, following, random, []
        if running is not None:
            self._pending, computed, stopped = running
            self._updates.resume(experience.rows(), computed, stopped)

    def _running(
        self, updates: Updates, tensors: dict[str, Tensor], state: dict[str, Any], experience: Experience, epochs: int
    ) -> tuple[list[NDArray[np.int64]], dict[str, Tensor], list[bool]] | None:
        """Return the state of an iteration whose updates had begun, or None if they had not."""
        if not epochs:
            return None
        if epochs > self._algorithm.epochs or not experience.steps:
            raise CheckpointError("the checkpoint's iteration has impossible epochs.")
        shapes = updates.iteration_shapes(experience.rows())
        computed = checked_tensors({f"{STATE}{name}": torch.zeros(shape) for name, shape in shapes.items()}, tensors)
        sizes, stopped = state.get("pending"), state.get("stopped")
        places = tensors.get(f"{STATE}pending")
        if not isinstance(sizes, list) or not sizes or not isinstance(stopped, list):
            raise CheckpointError("the checkpoint's minibatches are not readable.")
        if places is None or places.dtype != torch.int64 or places.ndim != 1 or len(stopped) != len(self.team.groups):
            raise CheckpointError("the checkpoint's minibatches are not readable.")
        used = np.isin(places.numpy(), updates.samples(experience.rows()))
        if not all(type(size) is int and size > 0 for size in sizes) or sum(sizes) != len(places) or not used.all():
            raise CheckpointError("the checkpoint's minibatches do not fit its iteration.")
        pending = np.split(places.numpy().copy(), np.cumsum(sizes)[:-1])
        return pending, {name.removeprefix(STATE): t for name, t in computed.items()}, [bool(s) for s in stopped]

    def largest_checkpoint(self) -> int:
        """Return an upper bound of the bytes of the networks, of two iterations' rows, and of networks' states."""
        networks = sum(tensor.nbytes for _, tensor in self._updates.network_tensors())
        if self._algorithm.shared_until < 1.0:
            networks *= max(group.count for group in self.team.groups) + 1
        team, rollout = self.team, self.config.rollout
        chunk = rollout.chunk_rows(rollout.chunk_steps)
        whole = self._algorithm.iteration_steps // (rollout.environments * rollout.chunk_steps) + 2
        rows = (2 * whole + DRAINED_CHUNKS) * chunk
        kind = observation_type(team, rounded=self.config.bfloat16_observations)
        observed = kind.itemsize * team.observation_size
        row = observed + 4 * (team.action_size + 4 * team.agents) + ROW_BYTES
        return int(networks + rows * row + self._largest_states(2 * whole + DRAINED_CHUNKS, whole))

    def _largest_states(self, chunks: int, whole: int) -> int:
        """Return the bytes of the states in these chunks and at the sequences of an iteration's `whole` chunks."""
        algorithm, rollout = self._algorithm, self.config.rollout
        sequences = whole * rollout.chunk_steps // algorithm.sequence_steps
        value_states = self.team.agents * (2 + algorithm.ensemble_size)
        states = chunks * self.team.agents + sequences * value_states
        return 4 * rollout.environments * states * algorithm.memory_size

    def statistics(self) -> dict[str, float]:
        """Return the diagnostics of the newest whole iteration, and statistics of its steps."""
        result = dict(self._updates.diagnostics.newest)
        result["learning_rate"] = self._algorithm.actor_rate * self._algorithm.rate_share(self.progress)
        result["iterations"] = float(self.iterations)
        result["iteration_occupancy"] = self.experience.steps / self._algorithm.iteration_steps
        result["sample_age_versions"] = self._lag
        return result

    def agent_statistics(self) -> dict[str, float]:
        """Return nothing: agents of a type learn from one loss."""
        return {}
