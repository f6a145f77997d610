"""Applies the imitation events that the leading coordinator sends."""

from collections.abc import Callable

from eia_sec.common.errors import ProtocolError
from eia_sec.common.imitation import ImitationEvent
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
        lease: which coordinator leads; events from others are refused.
        epoch: the learner's fencing epoch; events for another epoch are refused.
        on_applied: called with each event that changed the actors, before it is acknowledged.
    """

    def __init__(
        self,
        server: Server,
        trainer: Trainer,
        lease: Lease,
        epoch: int,
        on_applied: Callable[[ImitationEvent], None],
    ) -> None:
        self._server, self._trainer, self._lease, self._epoch = server, trainer, lease, epoch
        self._on_applied = on_applied

    def answer(self) -> None:
        """Answer every waiting request."""
        for incoming in self._server.waiting():
            try:
                event = self._checked(incoming)
                applied = self._trainer.imitate(event)
            except ProtocolError as error:
                incoming.reply(ReceiptMessage(False, str(error)[:LONGEST_REASON]).encode())
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
        return message.to_event()
