"""The learner without its network: experience in, update rounds, actors out.

    trainer = Trainer(config, team)
    while trainer.episodes < config.episodes:
        trainer.absorb(chunk, version)
        trainer.train(trainer.rounds_due())
        bank, version = trainer.actors(), trainer.next_version()

How many rounds are due follows from the counters alone, so a run that is resumed, or played in lockstep, does the same
rounds at the same points.
"""

import math
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor

from common.actors import ActorBank, imitate
from common.config import RunConfig
from common.errors import SchemaError
from common.imitation import ImitationEvent
from common.seeds import stream
from common.team import TeamSpec
from common.transitions import Chunk, EpisodeSummary
from learner.arithmetic import choose_products
from learner.engine import Engine, Figures
from learner.replay import Replay
from learner.state import (
    checked_tensors,
    counter,
    engine_tensors,
    episode_record,
    episode_summaries,
    finite,
    random_state,
    restored_random,
)

COUNTERS = ("environment_steps", "updates", "episodes", "version", "events", "evaluation_steps")
RECENT_EPISODES = 100
FIGURE_ROUNDS = 16
"""Every this many rounds one round tells its figures."""
FIGURE_SHARE = 0.05
"""Share of the newest figures in their running means."""


class Trainer:
    """All that a run's training consists of, and its counters.

    Args:
        config: the run.
        team: the layout of the team.

    Attributes:
        environment_steps: environment steps absorbed.
        updates: update rounds done.
        episodes: training episodes finished.
        version: number of the newest published parameters; 0 before the first.
        events: imitation events applied.
        evaluation_steps: environment steps that these events' evaluations took; part of the run's budget (A3).
        recent: the newest finished episodes.
    """

    def __init__(self, config: RunConfig, team: TeamSpec) -> None:
        self.config, self.team = config, team
        if torch.device(config.learner.device).type == "cpu":
            choose_products()
        self.engine = Engine(config.algorithm, team, config.seed, config.learner.device)
        self.replay = Replay(team, config.replay.capacity, config.learner.device)
        self.random = stream(config.seed, "replay")
        self.environment_steps = self.updates = self.episodes = self.version = self.events = 0
        self.evaluation_steps = 0
        self.recent: deque[EpisodeSummary] = deque(maxlen=RECENT_EPISODES)
        self._figures = torch.zeros(4, len(team.groups), device=config.learner.device)
        self._figure_rounds = 0
        self._age = 0.0

    def absorb(self, chunk: Chunk, version: int = 0) -> None:
        """Take a chunk into replay and count it.

        Args:
            chunk: rows that fit the team, and the episodes that ended in them.
            version: policy version that acted in it.
        """
        self.replay.add(chunk.rows, version)
        self.environment_steps += chunk.rows.steps
        self.episodes += len(chunk.episodes)
        self.recent.extend(chunk.episodes)

    def rounds_due(self) -> int:
        """Return floor(updates_per_step * steps after the warm-up) less the rounds done; 0 before a batch is there."""
        replay = self.config.replay
        if self.replay.transitions < self.config.algorithm.batch:
            return 0
        return math.floor(replay.updates_per_step * max(0, self.environment_steps - replay.warmup_steps)) - self.updates

    def leads(self) -> bool:
        """Return whether production leads consumption by more than the configured slack, so that producers wait."""
        replay = self.config.replay
        if replay.updates_per_step == 0:
            return False
        return self.rounds_due() / replay.updates_per_step > replay.slack_steps

    def train(self, rounds: int) -> None:
        """Do update rounds."""
        with _flushed_denormals():
            for _ in range(rounds):
                batch = self.replay.sample(self.config.algorithm.batch, self.random)
                wanted = self.updates % FIGURE_ROUNDS == 0
                figures = self.engine.round(batch, figures=wanted)
                self.updates += 1
                if figures is not None:
                    self._note(figures)

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Return everything from which `restore` continues bit-equal: tensors, and values that JSON can hold."""
        tensors = {f"engine.{name}": tensor.cpu() for name, tensor in engine_tensors(self.engine).items()}
        tensors |= {f"replay.{name}": tensor for name, tensor in self.replay.state().items()}
        tensors["figures"] = self._figures.cpu()
        plain: dict[str, Any] = {name: getattr(self, name) for name in COUNTERS}
        plain |= {
            "actor_adam_steps": self.engine.actor_adam.steps,
            "critic_adam_steps": self.engine.critic_adam.steps,
            "figure_rounds": self._figure_rounds,
            "sample_age": self._age,
            "random": random_state(self.random),
            "recent": [episode_record(episode) for episode in self.recent],
        }
        return tensors, plain

    def restore(self, tensors: dict[str, Tensor], state: dict[str, Any]) -> None:
        """Continue from `state`; nothing is changed unless all of it fits.

        Raises:
            CheckpointError: when something is missing or does not fit the configuration.
        """
        engine = self.engine
        own = {f"engine.{name}": tensor for name, tensor in engine_tensors(engine).items()} | {"figures": self._figures}
        found = checked_tensors(own, tensors)
        names = (*COUNTERS, "actor_adam_steps", "critic_adam_steps", "figure_rounds")
        counts = {name: counter(state, name) for name in names}
        random = restored_random(state.get("random"))
        recent = episode_summaries(state.get("recent"))
        age = finite(state, "sample_age")
        prefix = "replay."
        self.replay.restore({n.removeprefix(prefix): t for n, t in tensors.items() if n.startswith(prefix)})
        for name, tensor in own.items():
            tensor.copy_(found[name])
        for name in COUNTERS:
            setattr(self, name, counts[name])
        engine.actor_adam.steps, engine.critic_adam.steps = counts["actor_adam_steps"], counts["critic_adam_steps"]
        self._figure_rounds, self._age, self.random = counts["figure_rounds"], age, random
        self.recent = deque(recent, maxlen=RECENT_EPISODES)

    def _note(self, figures: Figures) -> None:
        parts = self.team.agent_slices()
        rows = [
            [figures.error[part].square().mean() for part in parts],
            [figures.value[part].mean() for part in parts],
            [figures.target[part].mean() for part in parts],
            [figures.error[part].abs().mean() for part in parts],
        ]
        newest = torch.stack([torch.stack(row) for row in rows])
        share = 1.0 if self._figure_rounds == 0 else FIGURE_SHARE
        self._figures.lerp_(newest, share)
        self._age += share * (self.version - self.replay.drawn_version - self._age)
        self._figure_rounds += 1

    def actors(self) -> ActorBank:
        """Return a copy of all actors."""
        return ActorBank(self.team, self.config.algorithm.hidden, self.engine.export_actors())

    def next_version(self) -> int:
        """Count up and return the version under which the present actors are published."""
        self.version += 1
        return self.version

    def imitate(self, event: ImitationEvent) -> bool:
        """Apply an imitation event to the actors, eq. (soft), unless it was applied before.

        Adam's moments stay as they are.

        Returns:
            Whether it was applied now.

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
        """Return running means of losses and values for each type, and the state of replay."""
        result: dict[str, float] = {}
        names = ("critic_loss", "actor_objective", "target_mean", "critic_error")
        for name, row in zip(names, self._figures.tolist(), strict=True):
            result |= {f"{name}/{group.name}": value for group, value in zip(self.team.groups, row, strict=True)}
        result["replay_rows"] = float(self.replay.rows)
        result["replay_occupancy"] = self.replay.occupancy
        result["sample_age_versions"] = self._age
        return result


@contextmanager
def _flushed_denormals() -> Iterator[None]:
    """Round numbers below 1e-38 to 0 meanwhile: moments of silent units decay into that range and cost time there."""
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)
