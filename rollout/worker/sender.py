"""Delivering chunks: a bounded spool, one acknowledged request at a time with all that waits, resent until settled."""

import threading
import time
from collections import deque
from dataclasses import dataclass
from itertools import islice

from common.errors import BusClosedError, BusError, ProtocolError
from common.history import Entry, History
from common.process import QUICK_SECONDS, log
from common.protocol import keys
from common.protocol.chunk_messages import fitting, to_message, to_request
from common.protocol.messages import MOST_CHUNKS, SETTLED, ChunkAck, Envelope
from common.team import TeamSpec
from common.transitions import Chunk
from common.transport.bus import Bus

ANSWER_SECONDS = 30.0
"""Time after which a request without an answer is made again; a learner that is behind answers late on purpose."""
LOCKSTEP_ANSWER_SECONDS = 3600.0
"""The same in lockstep, where the answer comes after the training that the chunk allows."""
HURRIED_SECONDS = 0.25
"""Time after which it is made again when the run or the worker ends, twice as long each time: an answer that was lost
with a router must not cost what the worker still holds. It is less than a draining learner waits for the next chunk."""
COMPLAINT_SECONDS = 10.0
"""Pause before the same error is logged again."""
NOBODY = 5
"""Requests in a row that nobody takes after which a worker that ends does not wait for a learner any more."""
RETRY_SECONDS = 0.2
"""Pause before a chunk is sent again after nobody answered."""


@dataclass(frozen=True)
class _Held:
    sequence: int
    version: int
    produced: int
    steps: int
    sealed: bytes


class Sender:
    """Sends chunks in sequence from a thread of its own.

    Attributes:
        flown: environment steps that the worker says it has flown, the chunk included that is offered next.
        produced: environment steps offered so far.
        accepted: environment steps that the learner has acknowledged.
        rejected: environment steps in chunks that the learner refused.
        retries: requests that had to be repeated.
        door_closed: whether the learner said last that it takes no more chunks.
        required_version: parameter version that the learner asks for before the next chunk (lockstep), else 0.
        waiting: seconds that requests have waited for their answers.
        untaken: requests in a row that nobody took.
        key: where requests go.
    """

    def __init__(
        self,
        bus: Bus,
        run: str,
        worker: str,
        incarnation: int,
        team: TeamSpec,
        capacity: int,
        patience: float,
        history: History | None = None,
    ) -> None:
        self.flown = self.produced = self.accepted = self.rejected = self.retries = self.required_version = 0
        self.waiting = 0.0
        self.untaken = 0
        self.door_closed = False
        self._bus, self._team, self._capacity, self._patience = bus, team, capacity, patience
        self.key = keys.TRANSITION.key(run, worker=worker)
        self._worker, self._incarnation = worker, incarnation
        self._held: deque[_Held] = deque()
        self._sequence = 0
        self._complaint, self._complained = "", 0.0
        self._history = history or History(None)
        self._changed = threading.Condition()
        self._hurried = self._ended = False
        self._again_after = HURRIED_SECONDS
        self._thread = threading.Thread(target=self._run, name="sender", daemon=True)
        self._thread.start()

    @property
    def full(self) -> bool:
        """Return whether as many chunks are held as may be; nothing more may be made until one is answered."""
        return len(self._held) >= self._capacity

    def offer(self, chunk: Chunk, version: int) -> None:
        """Take over a chunk that has just been made, when the spool is not full, and write it into the history."""
        steps = chunk.rows.steps
        sealed = to_message(chunk, self._team, version, self.produced + steps).encode()
        with self._changed:
            self._sequence += 1
            self.produced += steps
            number = self._sequence
            made = Entry("produced", self._worker, self._incarnation, number, number, steps, self.produced, self.flown)
            self._history.add(made)
            self._held.append(_Held(number, version, self.produced, steps, sealed))
            self._changed.notify_all()

    @property
    def spooled(self) -> int:
        """Return the number of chunks that are held."""
        return len(self._held)

    @property
    def in_flight(self) -> int:
        """Return the environment steps that are flown and neither accepted nor rejected."""
        return max(self.flown, self.produced) - self.accepted - self.rejected

    def wait_empty(self, timeout: float) -> bool:
        """Wait until all is answered, or the learner takes no more or is not there; return whether none is held."""
        self.hurry()
        deadline, before = time.monotonic() + timeout, self.untaken
        while self._held and not self.door_closed and time.monotonic() < deadline:
            before = min(before, self.untaken)
            if self.untaken - before >= NOBODY:
                break
            time.sleep(0.01)
        return not self._held

    def hurry(self, wanted: bool = True) -> None:
        """Make a request again soon that is not answered, and not only after the usual patience."""
        self._hurried = wanted

    def close(self) -> None:
        """End the thread; what is still held is not delivered."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        self._bus.close()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._held or self._ended)
                if self._ended:
                    return
                waiting = list(islice(self._held, MOST_CHUNKS))
            try:
                settled = self._deliver(waiting[: fitting([len(held.sealed) for held in waiting])])
            except BusClosedError:
                return
            if not settled:
                self.retries += 1
                time.sleep(RETRY_SECONDS)

    def _deliver(self, batch: list[_Held]) -> bool:
        """Send chunks, the oldest first, and let go of those that are settled; return whether all are."""
        head = batch[0]
        envelope = Envelope("rollout", self._worker, self._incarnation, head.sequence, head.version)
        flown = max(self.flown, batch[-1].produced)
        payload = to_request([held.sealed for held in batch], head.sequence, flown)
        started = time.monotonic()
        ack, heard = self._ask(payload, envelope.encode())
        waited = time.monotonic() - started
        self.waiting += waited
        self.untaken = 0 if heard or waited >= QUICK_SECONDS else self.untaken + 1
        self.door_closed = ack is not None and "closed" in ack.verdicts
        if ack is None:
            return False
        told = [pair for pair in zip(ack.verdicts, ack.reasons, strict=False) if pair[0] in SETTLED]
        for held, (verdict, reason) in zip(batch, told, strict=False):
            self._settle(held, verdict, reason, ack.required_version)
        return len(told) >= len(batch)

    def _ask(self, payload: bytes, attachment: bytes) -> tuple[ChunkAck | None, bool]:
        """Return the answer, and whether there was any, be it a refusal."""
        self._again_after = HURRIED_SECONDS
        try:
            answer = self._bus.ask(self.key, payload, self._patience, attachment, self._again)
            return (None if answer is None else ChunkAck.decode(answer)), answer is not None
        except BusClosedError:
            raise
        except (BusError, ProtocolError) as error:
            self._complain(str(error))
            return None, True

    def _again(self, waited: float) -> bool:
        if not self._hurried or waited < self._again_after:
            return False
        self._again_after *= 2.0
        self.retries += 1
        return True

    def _complain(self, text: str) -> None:
        """Log an error, the same one not more often than every COMPLAINT_SECONDS."""
        now = time.monotonic()
        if text != self._complaint or now - self._complained >= COMPLAINT_SECONDS:
            log(f"worker {self._worker}: {text}")
            self._complaint, self._complained = text, now

    def _settle(self, held: _Held, verdict: str, reason: str, required_version: int) -> None:
        """Let go of the oldest chunk."""
        number, steps = held.sequence, held.steps
        with self._changed:
            # Before the spool looks empty: in lockstep the worker flies on as soon as it does.
            self.required_version = required_version
            kept = {"refused": "refused", "duplicate": "repeated"}.get(verdict, "acknowledged")
            self._history.add(Entry(kept, self._worker, self._incarnation, number, number, steps))
            self._held.popleft()
            if verdict == "refused":
                self.rejected += steps
                log(f"worker {self._worker}: chunk {number} was refused: {reason}")
            else:
                self.accepted += steps
            self._changed.notify_all()
