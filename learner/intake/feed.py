"""Waits for accepted chunks, and hands each on once, together with its ledger."""

import queue
from collections.abc import Callable
from typing import Any, Final

from eia_sec.common.clock import monotonic
from eia_sec.common.loops import Loop
from eia_sec.common.protocol.messages import ChunkAck
from eia_sec.learner.intake.arrival import Arrival
from eia_sec.learner.intake.ledger import LedgerSnapshot
from eia_sec.learner.intake.limits import DRAINED_CHUNKS
from eia_sec.learner.intake.receiver import Receiver
from eia_sec.learner.trainer import Trainer

DRAIN_SECONDS: Final = 3.0
"""Longest time for which a draining learner takes in chunks that workers still hold."""
QUIET_SECONDS: Final = 1.0
"""Silence after which a draining learner assumes that workers hold no more chunks."""
LAG_WEIGHT: Final = 0.05
"""Weight of the newest chunk in the moving average of the version lag."""


class ExperienceFeed:
    """Takes accepted chunks from the receiver's queue; for one thread.

    Args:
        receiver: where chunks arrive.
        trainer: whose parameter version tells how old they are.
        ledger: the ledger of the chunks that are already in the trainer.
        absorb: puts a chunk into the trainer.

    Attributes:
        ledger: the ledger of exactly those chunks that the trainer holds; a checkpoint needs it.
    """

    def __init__(
        self,
        receiver: Receiver,
        trainer: Trainer,
        ledger: LedgerSnapshot,
        absorb: Callable[[Arrival], None],
    ) -> None:
        self._receiver, self._trainer, self._absorb = receiver, trainer, absorb
        self.ledger = ledger
        self._lag = 0.0

    def absorb_waiting(self, may_absorb: Callable[[], bool]) -> None:
        """Absorb the chunks that have arrived, for as long as `may_absorb` returns True."""
        while may_absorb():
            try:
                self._take(self._receiver.arrivals.get_nowait())
            except queue.Empty:
                return

    def absorb_next(self, seconds: float = 0.0) -> Loop[Arrival | None]:
        """Return the loop that absorbs the next chunk and returns it, or None when none arrives in about this time."""
        if self._receiver.arrivals.empty():
            yield seconds
        try:
            arrival = self._receiver.arrivals.get_nowait()
        except queue.Empty:
            return None
        self._take(arrival)
        return arrival

    def drain(self, between: Callable[[], None]) -> Loop[None]:
        """Return the loop that absorbs what workers still deliver, DRAINED_CHUNKS at most, until they are silent.

        Args:
            between: called after each wait.
        """
        started = last = monotonic()
        taken = 0
        while (now := monotonic()) - started < DRAIN_SECONDS and now - last < QUIET_SECONDS:
            if taken >= DRAINED_CHUNKS:
                return
            if (yield from self.absorb_next(0.02)) is not None:
                last = monotonic()
                taken += 1
            between()

    def close(self) -> None:
        """Accept no more chunks; absorb and answer those that were accepted."""
        self._receiver.close()
        while not self._receiver.arrivals.empty():
            arrival = self._receiver.arrivals.get_nowait()
            self._take(arrival)
            self.answer(arrival)

    def answer(self, arrival: Arrival) -> None:
        """Send the acknowledgement of a chunk that waits until training is done (lockstep)."""
        if arrival.owed is not None:
            expected = arrival.ledger.workers[arrival.sender.name].expected
            arrival.owed.answer(ChunkAck(("accepted",), ("",), expected, self._trainer.version).encode())

    def metrics(self) -> dict[str, Any]:
        """Return the metrics of the intake."""
        totals, ledgers = self._receiver.ledger.accounts()
        unexplained = self._receiver.unexplained(self._trainer.environment_steps)
        return {
            "lag_versions": self._lag,
            **self._receiver.metrics(),
            "ledger": {**totals, "unexplained": unexplained},
            "ledgers": ledgers,
        }

    def alarms(self) -> list[str]:
        """Return one sentence for each worker that is blocked."""
        return self._receiver.peer_penalties.alarms()

    def _take(self, arrival: Arrival) -> None:
        self._absorb(arrival)
        self.ledger = arrival.ledger
        self._lag += LAG_WEIGHT * (self._trainer.version - arrival.sender.version - self._lag)
