"""The training of a run, without communication: experience in, updates, actors out.

    trainer = make_trainer(config, team)                    # eia_sec.learner.trainers
    while trainer.progress < 1.0:
        trainer.absorb(chunk, version)
        trainer.train(trainer.updates_due())
        actors, version = trainer.actors(), trainer.next_version()

The number of updates due depends only on the counters, so a resumed run, or one in lockstep, does the same updates at
the same points. `OffPolicyTrainer` learns from a replay buffer, `OnPolicyTrainer` in iterations.
"""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, ClassVar, Final

import numpy as np
import torch
from torch import Tensor

from eia_sec.common.actors import TeamActors, blend, imitate
from eia_sec.common.config import RunConfig
from eia_sec.common.errors import CheckpointError, SchemaError
from eia_sec.common.imitation import ImitationEvent
from eia_sec.common.population import Exploit, checked_hyperparameters, hyperparameters_of
from eia_sec.common.reward_sums import RewardSums
from eia_sec.common.team import Float32, TeamSpec
from eia_sec.common.transitions import Chunk, EpisodeSummary
from eia_sec.learner.checkpoint.tensor_snapshot import Frozen, whole
from eia_sec.learner.checkpoint.trainer_state import (
    counter,
    episode_record,
    episode_summaries,
    mapping,
    restored_rewards,
    rewards_record,
)
from eia_sec.learner.networks.device import usable_device

COUNTERS: Final = ("environment_steps", "updates", "episodes", "version", "events", "evaluation_steps")
RECENT_EPISODES: Final = 100


class Trainer(ABC):
    """Networks, experience and counters of one run.

    Args:
        config: the run.
        team: the layout of the team.

    Raises:
        ConfigError: when the configured device does not exist.

    Attributes:
        publishes_at_once: whether changed actors are published at once, not at most every `learner.publish_seconds`.
        burst: most updates between two polls for incoming messages.
        environment_steps: environment steps absorbed.
        updates: updates done.
        episodes: training episodes finished.
        version: number of the newest published parameters; 0 before the first.
        events: imitation events applied.
        evaluation_steps: environment steps that these events' evaluations took; part of the run's budget (A3).
        round: newest round of a population that it took part in; 0 before the first.
        exploits: rounds in which its actors imitated another learner's.
        replaced: newest version whose actors are gone, because agents got others in such a round; 0 before the first.
        separate_since: episodes that were finished when agents got actors of their own; None while they share them.
        rewards: of each agent in training, since agents got actors of their own or in a round another learner's; before
            that from the beginning.
        recent: the newest finished episodes.
    """

    publishes_at_once: ClassVar[bool] = False
    burst: ClassVar[int] = 8

    def __init__(self, config: RunConfig, team: TeamSpec) -> None:
        self.config, self.team = config, team
        usable_device(config.learner.device)
        self.environment_steps = self.updates = self.episodes = self.version = self.events = 0
        self.evaluation_steps = self.round = self.exploits = self.replaced = 0
        self.separate_since: int | None = 0
        self.rewards = RewardSums.none(team.agents)
        self.recent: deque[EpisodeSummary] = deque(maxlen=RECENT_EPISODES)

    def absorb(self, chunk: Chunk, version: int = 0, source: str = "", number: int = 0) -> None:
        """Take in a chunk and count it.

        Args:
            chunk: rows that fit the team, and the episodes that ended in them.
            version: policy version that acted in it.
            source: name of the worker's start that made it; empty if no later chunk continues its trajectories.
            number: number of the chunk among those of the source.
        """
        self.take_in(chunk, version, source, number)
        if not self.exploits or version > self.replaced:
            self.rewards = self.rewards.plus(chunk.rows.reward, chunk.rows.steps)
        self.environment_steps += chunk.rows.steps
        self.episodes += len(chunk.episodes)
        self.recent.extend(chunk.episodes)

    @abstractmethod
    def take_in(self, chunk: Chunk, version: int, source: str, number: int) -> None:
        """Store the rows of a chunk; arguments as for `absorb`."""

    @abstractmethod
    def updates_due(self) -> int:
        """Return how many updates are due."""

    @abstractmethod
    def leads(self) -> bool:
        """Return whether collection is so far ahead of updates that workers must wait."""

    @abstractmethod
    def train(self, updates: int) -> None:
        """Do this many updates."""

    @abstractmethod
    def actors(self) -> TeamActors:
        """Return a copy of all actors."""

    @abstractmethod
    def load_actors(self, flat: tuple[Float32, ...]) -> None:
        """Replace the actors' parameters, [n_v or 1, P_v] for each type in the order of `eia_sec.common.actors`."""

    def begin_with(self, start: Sequence[Float32 | None]) -> None:
        """Replace the parameters of fresh actors, [n_v or 1, P_v] for each type; None keeps a type's own."""
        own = self.actors().flat
        self.load_actors(tuple(old if new is None else new for old, new in zip(own, start, strict=True)))

    @abstractmethod
    def statistics(self) -> dict[str, float]:
        """Return what is reported about updates and experience."""

    @abstractmethod
    def agent_statistics(self) -> dict[str, float]:
        """Return what is reported about single agents' updates, as NAME/TYPE-INDEX."""

    @abstractmethod
    def largest_checkpoint(self) -> int:
        """Return the most bytes that the large tensors of a checkpoint can take."""

    @property
    def progress(self) -> float:
        """The finished share of the run, 0 to 1."""
        return self.config.progress(self.episodes, self.environment_steps)

    @property
    def changes(self) -> int:
        """A number that changes whenever there are other actors to publish."""
        return self.updates + self.events + self.exploits

    @property
    def between_iterations(self) -> bool:
        """Whether actors may be changed from outside: no iteration's updates are halfway done."""
        return True

    @property
    def iteration(self) -> tuple[int, int] | None:
        """The iteration that the next chunks enter, and the steps that it still takes in.

        None where experience is taken in all the time.
        """
        return None

    def next_version(self) -> int:
        """Increment the version and return it; the present actors are published under it."""
        self.version += 1
        return self.version

    def imitate(self, event: ImitationEvent) -> bool:
        """Apply an imitation event to the actors, eq. (soft), unless it has been applied already.

        The optimiser's moments do not change.

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
        if self.exploits and event.version <= self.replaced:
            raise SchemaError(f"imitation event {event.event} scores actors that round {self.round} has replaced.")
        flat = self.actors().flat
        for parameters, elite in zip(flat, event.elites, strict=True):
            imitate(parameters, elite, event.rate)
        self.load_actors(flat)
        self.events += 1
        self.evaluation_steps += event.evaluation_steps
        return True

    def exploit(self, event: Exploit) -> bool:
        """Apply a round of a population, unless it has been applied already: imitate, and go on with hyperparameters.

        Value functions, critics and the optimiser's moments do not change.

        Returns:
            Whether this call applied it.

        Raises:
            SchemaError: when it does not fit the team or the configuration.
        """
        event.check(self.team, self.config)
        if event.round <= self.round:
            return False
        if event.imitates:
            flat = self.actors().flat
            for group, own, elite in zip(self.team.groups, flat, event.flat, strict=True):
                if len(elite) and (elite.shape[1] != own.shape[1] or len(elite) not in (1, len(own))):
                    raise SchemaError(f"the round's parameters are not those of {group.name} agents.")
                if not np.isfinite(elite).all():
                    raise SchemaError("the round's parameters hold a number that is not finite.")
            for own, elite in zip(flat, event.flat, strict=True):
                if len(elite):
                    blend(own, elite, event.rate)
            self.load_actors(flat)
            self.exploits, self.replaced = self.exploits + 1, self.version
            self.rewards = RewardSums.none(self.team.agents)
        self._tune(event.hyperparameters)
        self.round = event.round
        self.evaluation_steps += event.evaluation_steps
        return True

    def _tune(self, values: Mapping[str, float]) -> None:
        """Go on with other hyperparameters."""
        if values != hyperparameters_of(self.config):
            self.config = replace(self.config, algorithm=self.config.algorithm.with_live(values))
            self.retune()

    @abstractmethod
    def retune(self) -> None:
        """Take the options of the configured algorithm that are `live` from `config`, which has others now."""

    @abstractmethod
    def snapshot_parts(self) -> tuple[dict[str, Tensor | Frozen], dict[str, Any]]:
        """Return networks and experience as `snapshot` does, without the counters."""

    @abstractmethod
    def restore_parts(self, tensors: dict[str, Tensor], state: dict[str, Any]) -> None:
        """Continue from `snapshot_parts`; if any part does not fit, change nothing and raise CheckpointError."""

    def snapshot(self) -> tuple[dict[str, Tensor | Frozen], dict[str, Any]]:
        """Return the state from which `restore` continues bit-equal: tensors, and values that JSON can hold.

        It is the state at this instant, whatever training does afterwards. The large tensors are copied only when read.
        """
        tensors, plain = self.snapshot_parts()
        plain |= {name: getattr(self, name) for name in COUNTERS}
        plain["recent"] = [episode_record(episode) for episode in self.recent]
        plain |= {"separate_since": self.separate_since, "rewards": rewards_record(self.rewards)}
        if self.config.population.members:
            values = hyperparameters_of(self.config)
            counts = {"round": self.round, "exploits": self.exploits, "replaced": self.replaced}
            plain["population"] = {**counts, "hyperparameters": values}
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
        counts = {name: counter(state, name) for name in COUNTERS}
        recent = episode_summaries(state.get("recent"))
        since = None if state.get("separate_since", 0) is None else counter(state, "separate_since")
        if since is None and self.separate_since is not None:
            raise CheckpointError("the checkpoint's agents share networks, and those of the configuration do not.")
        rewards = restored_rewards(state.get("rewards"), self.team.agents)
        counted, values = self._of_population(state)
        self.restore_parts(tensors, state)
        self.separate_since, self.rewards = since, rewards
        self.round, self.exploits, self.replaced = counted
        self._tune(values)
        for name in COUNTERS:
            setattr(self, name, counts[name])
        self.recent = deque(recent, maxlen=RECENT_EPISODES)

    def _of_population(self, state: Mapping[str, Any]) -> tuple[tuple[int, int, int], dict[str, float]]:
        """Return round, exploits and replaced version, and the hyperparameters, in a checkpoint's state."""
        if not self.config.population.members:
            return (0, 0, 0), {}
        held = mapping(state, "population")
        try:
            values = checked_hyperparameters(self.config, mapping(held, "hyperparameters"))
        except SchemaError as error:
            raise CheckpointError(f"the checkpoint's hyperparameters do not fit the configuration: {error}") from error
        return (counter(held, "round"), counter(held, "exploits"), counter(held, "replaced")), values


@contextmanager
def flushed_denormals() -> Iterator[None]:
    """Flush numbers below 1e-38 to 0 in this block: moments of inactive units decay into that range and are slow."""
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)
