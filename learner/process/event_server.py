"""Answers the leading coordinator's requests to apply something to the trainer: each is applied once or refused."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import ClassVar, Final, Generic, TypeVar

from eia_sec.common.errors import ProtocolError
from eia_sec.common.protocol.messages import Envelope, ExploitMessage, ImitationMessage, ReceiptMessage
from eia_sec.common.transport.bus import Server
from eia_sec.learner.process.lease import Lease
from eia_sec.learner.trainer import Trainer

LONGEST_REASON: Final = 400
"""Most characters of a refusal."""

Message = TypeVar("Message", ImitationMessage, ExploitMessage)


class EventServer(ABC, Generic[Message]):
    """Answers requests of one kind.

    Args:
        server: where they come in.
        trainer: the trainer to which they are applied.
        lease: which coordinator leads; requests of others are refused.
        epoch: the learner's fencing epoch; requests for another epoch are refused.

    Attributes:
        refused: requests that were not applied and never will be.
    """

    what: ClassVar[str]
    """What one asks to apply, as in "the event"."""
    requests: ClassVar[str]
    """What many are called in the alarm."""
    message: type[Message]
    """What they carry."""

    def __init__(self, server: Server, trainer: Trainer, lease: Lease, epoch: int) -> None:
        self._server, self._trainer, self._lease, self._epoch = server, trainer, lease, epoch
        self.refused, self._reason = 0, ""

    def answer(self) -> None:
        """Answer every waiting request."""
        for incoming in self._server.waiting():
            try:
                message = self.message.decode(incoming.payload)
                if message.epoch != self._epoch:
                    raise ProtocolError(f"the {self.what} is for another start of the learner.")
                sender = Envelope.decode(incoming.attachment)
                if not self._lease.holds(sender.name, sender.incarnation):
                    raise ProtocolError("another coordinator leads.")
                applied = self._apply(message)
            except ProtocolError as error:
                self.refused, self._reason = self.refused + 1, str(error)[:LONGEST_REASON]
                incoming.reply(ReceiptMessage(False, self._reason).encode())
                continue
            if applied is not None:
                applied()
            incoming.reply(ReceiptMessage(True, "applied before" if applied is None else "").encode())

    @abstractmethod
    def _apply(self, message: Message) -> Callable[[], None] | None:
        """Apply a request of the leading coordinator.

        Returns:
            what is to be done before it is acknowledged; None if it was applied before.

        Raises:
            ProtocolError: it must not be applied.
        """

    def alarms(self) -> list[str]:
        """Return a sentence if requests were refused."""
        if not self.refused:
            return []
        return [f"{self.refused} {self.requests} were refused; the last one: {self._reason}"]
