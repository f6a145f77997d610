"""Applies the imitation events that the leading coordinator sends."""

import math
from collections.abc import Callable

from eia_sec.common.errors import ProtocolError, SchemaError
from eia_sec.common.imitation import ImitationEvent, ImitationSchedule
from eia_sec.common.protocol.messages import Envelope, ImitationMessage, ReceiptMessage
from eia_sec.common.transport.bus import Incoming, Server
from eia_sec.learner.process.lease import Lease
from eia_sec.learner.trainer import Trainer

LONGEST_REASON = 400
"""Most characters of a refusal."""


class ImitationServer:
    """Answers requests to apply an imitation event.

    Args:
        server: where they come in.
        trainer: the trainer whose actors imitate.
        schedule: when events are due, by the learner's own configuration.
        lease: which coordinator leads; events from others are refused.
        epoch: the learner's fencing epoch; events for another epoch are refused.
        on_applied: called with each event that changed the actors, before it is acknowledged.

    Attributes:
        refused: requests that were not applied and never will be.
    """

    def __init__(
        self,
        server: Server,
        trainer: Trainer,
        schedule: ImitationSchedule,
        lease: Lease,
        epoch: int,
        on_applied: Callable[[ImitationEvent], None],
    ) -> None:
        self._server, self._trainer, self._lease, self._epoch = server, trainer, lease, epoch
        self._schedule, self._on_applied = schedule, on_applied
        self.refused, self._reason = 0, ""

    def answer(self) -> None:
        """Answer every waiting request."""
        for incoming in self._server.waiting():
            try:
                event = self._checked(incoming)
                applied = self._trainer.imitate(event)
            except ProtocolError as error:
                self.refused, self._reason = self.refused + 1, str(error)[:LONGEST_REASON]
                incoming.reply(ReceiptMessage(False, self._reason).encode())
                continue
            if applied:
                self._on_applied(event)
            incoming.reply(ReceiptMessage(True, "" if applied else "applied before").encode())

    def _checked(self, incoming: Incoming) -> ImitationEvent:
        message = ImitationMessage.decode(incoming.payload)
        if message.epoch != self._epoch:
            raise ProtocolError("the event is for another start of the learner.")
        sender = Envelope.decode(incoming.attachment)
        if not self._lease.holds(sender.name, sender.incarnation):
            raise ProtocolError("another coordinator leads.")
        self._require_due(event := message.to_event())
        return event

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

    def alarms(self) -> list[str]:
        """Return a sentence if requests were refused."""
        if not self.refused:
            return []
        return [f"{self.refused} requests to imitate were refused; the last one: {self._reason}"]
