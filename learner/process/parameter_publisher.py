"""Publishes the learner's parameters and its progress."""

from eia_sec.common.actors import TeamActors
from eia_sec.common.population import hyperparameters_of
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import ParametersMessage, ProgressMessage
from eia_sec.common.transport.bus import Bus
from eia_sec.learner.intake.iteration_room import Terms
from eia_sec.learner.trainer import Trainer


class ParameterPublisher:
    """Publishes both as states on the control lane, so late subscribers get the newest ones.

    Args:
        bus: the control lane.
        run: the run's name.
        epoch: the learner's fencing epoch.
        trainer: what is published.
    """

    def __init__(self, bus: Bus, run: str, epoch: int, trainer: Trainer) -> None:
        self._parameters = bus.publish_state(keys.PARAMETERS.key(run), keys.PARAMETERS.encoding)
        self._progress = bus.publish_state(keys.PROGRESS.key(run), keys.PROGRESS.encoding)
        self._epoch, self._trainer = epoch, trainer
        self._published = -1

    @property
    def unpublished(self) -> int:
        """How often the actors have changed since they were last published."""
        return self._trainer.changes - self._published

    def publish_parameters(self, actors: TeamActors) -> None:
        """Publish the trainer's present actors under its present version."""
        trainer = self._trainer
        self._published = trainer.changes
        message = ParametersMessage(
            epoch=self._epoch,
            version=trainer.version,
            event=trainer.events,
            environment_steps=trainer.environment_steps,
            progress=trainer.progress,
            team=actors.team.digest,
            hidden=actors.hidden,
            head=actors.head,
            flat=actors.flat,
            memory=None if actors.memory == "none" else actors.memory,
        )
        self._parameters.put(message.encode())

    def publish_progress(self, state: str, terms: Terms, arguments: str) -> None:
        """Publish the trainer's counters and what the learner does.

        Args:
            state: training, draining or finished.
            terms: what workers are asked for.
            arguments: those that environments have from their next episodes on, or empty.
        """
        t = self._trainer
        member = t.config.population.members > 0
        message = ProgressMessage(
            epoch=self._epoch,
            version=t.version,
            events=t.events,
            episodes=t.episodes,
            environment_steps=t.environment_steps,
            updates=t.updates,
            state=state,
            separate_since=t.separate_since,
            reward_steps=t.rewards.steps,
            reward_sums=t.rewards.sums if t.rewards.steps else None,
            window=terms.window,
            asked_steps=terms.asked_steps,
            arguments=arguments,
            round=t.round if member else None,
            hyperparameters=hyperparameters_of(t.config) if member else None,
        )
        self._progress.put(message.encode())
