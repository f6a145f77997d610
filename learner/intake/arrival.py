"""An accepted chunk on its way into replay, and the answer that a lockstep learner owes for it."""

import threading
from dataclasses import dataclass

from eia_sec.common.protocol.messages import Envelope
from eia_sec.common.transitions import Chunk
from eia_sec.common.transport.bus import Incoming
from eia_sec.learner.intake.ledger import LedgerSnapshot


class OwedAnswer:
    """The answer to a chunk that the learner trains on first (lockstep); it goes to the newest copy of the request."""

    def __init__(self, incoming: Incoming) -> None:
        self._incoming: Incoming | None = incoming
        self._lock = threading.Lock()

    def renew(self, incoming: Incoming) -> bool:
        """Answer this copy instead, because the earlier copy's link may be gone; return False if already answered."""
        with self._lock:
            if self._incoming is None:
                return False
            self._incoming = incoming
            return True

    def answer(self, payload: bytes) -> None:
        """Send the answer, unless it was sent before."""
        with self._lock:
            incoming, self._incoming = self._incoming, None
        if incoming is not None:
            incoming.reply(payload)


@dataclass(frozen=True)
class Arrival:
    """An accepted chunk.

    Attributes:
        chunk: the experience.
        sender: who sent it, with its parameter version.
        ledger: the ledger with this chunk in it. Chunks accepted before this one are ahead of it in the queue.
        owed: the answer that the learner owes (lockstep), else None.
    """

    chunk: Chunk
    sender: Envelope
    ledger: LedgerSnapshot
    owed: OwedAnswer | None
