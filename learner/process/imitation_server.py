"""Applies the imitation events that the leading coordinator sends."""

import math
from collections.abc import Callable
from functools import partial

from eia_sec.common.errors import SchemaError
from eia_sec.common.imitation import ImitationEvent, ImitationSchedule
from eia_sec.common.protocol.messages import ImitationMessage
from eia_sec.common.transport.bus import Server
from eia_sec.learner.process.event_server import EventServer
from eia_sec.learner.process.lease import Lease
from eia_sec.learner.trainer import Trainer


class ImitationServer(EventServer[ImitationMessage]):
    """Answers requests to apply an imitation event; see `EventServer`.

    Args:
        server: where they come in.
        trainer: the trainer whose actors imitate.
        schedule: when events are due, by the learner's own configuration.
        lease: which coordinator leads.
        epoch: the learner's fencing epoch.
        on_applied: called with each event that changed the actors, before it is acknowledged.
    """

    what, requests, message = "event", "requests to imitate", ImitationMessage

    def __init__(
        self,
        server: Server,
        trainer: Trainer,
        schedule: ImitationSchedule,
        lease: Lease,
        epoch: int,
        on_applied: Callable[[ImitationEvent], None],
    ) -> None:
        super().__init__(server, trainer, lease, epoch)
        self._schedule, self._on_applied = schedule, on_applied

    def _apply(self, message: ImitationMessage) -> Callable[[], None] | None:
        self._require_due(event := message.to_event())
        return partial(self._on_applied, event) if self._trainer.imitate(event) else None

    def _require_due(self, event: ImitationEvent) -> None:
        """Raise SchemaError for an event that the configuration does not have, or not yet."""
        number, trainer = max(1, event.event), self._trainer
        if event.event > trainer.events + 1:
            raise SchemaError(f"imitation event {event.event} cannot follow event {trainer.events}.")
        if self._schedule.due_episode(number) is None:
            raise SchemaError(f"imitation event {event.event} never falls due in this run.")
        due = self._schedule.after(trainer.separate_since).due_episode(number)
        if due is None:
            raise SchemaError(f"imitation event {event.event} came while agents share their actors.")
        if event.episode != due or trainer.episodes < due:
            raise SchemaError(
                f"imitation event {event.event} falls due at episode {due}, not {event.episode}; "
                f"{trainer.episodes} are finished."
            )
        if not math.isclose(event.rate, rate := self._schedule.rate(event.event), rel_tol=1e-9):
            raise SchemaError(f"imitation event {event.event} has the rate {rate:g}, not {event.rate:g}.")
        if event.version > trainer.version:
            raise SchemaError(f"imitation event {event.event} evaluated version {event.version}, which does not exist.")

    def metrics(self) -> dict[str, int]:
        """Return the metrics to report."""
        return {"imitations_refused": self.refused}
