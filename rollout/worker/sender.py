"""Delivery of chunks: a bounded spool, and one request at a time that is resent until the learner has settled it."""

import math
import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from itertools import islice

from eia_sec.common.clock import monotonic
from eia_sec.common.errors import BusClosedError, BusError, ProtocolError, UsageError
from eia_sec.common.history.history import Entry, History
from eia_sec.common.log import log
from eia_sec.common.loops import Loop
from eia_sec.common.process import QUICK_SECONDS
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.chunk_messages import MOST_CHUNKS, SETTLED, fitting, to_message, to_request
from eia_sec.common.protocol.chunk_rules import ChunkRules
from eia_sec.common.protocol.codec import NO_LIMIT
from eia_sec.common.protocol.messages import ChunkAck, Envelope
from eia_sec.common.team import TeamSpec
from eia_sec.common.transitions import Chunk
from eia_sec.common.transport.bus import Bus

ANSWER_SECONDS = 30.0
"""Time after which an unanswered request is resent. A learner that is behind answers late on purpose."""
LOCKSTEP_ANSWER_SECONDS = 3600.0
"""Time limit of a request in lockstep, where the answer follows the training that the chunk allows. It is resent
meanwhile, every ANSWER_SECONDS, because an answer may get lost."""
FAST_RESEND_SECONDS = 0.25
"""First resend time when the run or the worker ends; it doubles with each resend. It is short because a router may fail
and lose an answer, and a draining learner does not wait long for the next chunk."""
SAME_ERROR_SECONDS = 10.0
"""Pause before the same error is logged again."""
MOST_UNTAKEN = 5
"""An ending worker gives up on the learner after this many requests in a row that nobody takes."""
IDLE_SECONDS = 1.0
"""Pause of a sender with an empty spool; an offer ends it."""
RETRY_SECONDS = 0.2
"""Pause before unsettled chunks are sent again."""
UNDELIVERED = "were not delivered"
"""What a worker's last words say of the steps that are lost with it."""


@dataclass(frozen=True)
class _Held:
    sequence: int
    version: int
    produced: int
    steps: int
    sealed: bytes


class Sender:
    """Sends the chunks of the spool in sequence; `deliver` is a loop for a thread of its own.

    A request holds all waiting chunks, oldest first. A chunk leaves the spool once the learner has accepted it, refused
    it or reported it as a duplicate. Nothing is ever dropped: when the spool is full, the worker waits
    (`CollectionGate`).

    Args:
        bus: the lane for chunks.
        run: the run's name.
        worker: the worker's name.
        incarnation: number of this start.
        team: layout of the rows.
        rules: the shape of chunks, and how many the spool holds.
        patience: seconds after which an unanswered request is resent.
        history: where chunks and verdicts are recorded.

    Attributes:
        flown: environment steps that the worker has collected, including those of the chunk offered next.
        produced: environment steps offered so far.
        accepted: environment steps that the learner has acknowledged.
        rejected: environment steps in chunks that the learner refused.
        left_behind: environment steps of a chunk that can never be offered.
        retries: requests that had to be repeated.
        learner_closed: whether the learner's last answer said that it takes no more chunks.
        replaced: whether a newer start of this worker now delivers. If so, nothing more is sent.
        required_version: parameter version that the learner asks for before the next chunk, 0 for none.
        window: environment steps that may be under way, by the newest answer.
        asked_steps: environment steps of the next chunk at most, by that answer.
        answered_at: time of that answer, by the monotonic clock.
        waiting: seconds that requests have waited for their answers.
        untaken: requests in a row that nobody took.
        key: where requests go.
        offered: set when there is something to send.
    """

    def __init__(
        self,
        bus: Bus,
        run: str,
        worker: str,
        incarnation: int,
        team: TeamSpec,
        rules: ChunkRules,
        patience: float,
        history: History | None = None,
    ) -> None:
        self.flown = self.produced = self.accepted = self.rejected = self.retries = self.required_version = 0
        self.waiting = self.answered_at = 0.0
        self.left_behind = 0
        self.window = self.asked_steps = NO_LIMIT
        self.untaken = 0
        self.learner_closed = self.replaced = False
        self._bus, self._team, self._rules, self._patience = bus, team, rules, patience
        self.key = keys.TRANSITION.key(run, worker=worker)
        self._worker, self._incarnation = worker, incarnation
        self._held: deque[_Held] = deque()
        self._sequence = 0
        self._last_error, self._last_error_at = "", 0.0
        self._history = history or History(None)
        self.offered, self._lock = threading.Event(), threading.Lock()
        self._resends_fast = self._ended = False
        self._resend_after = FAST_RESEND_SECONDS

    @property
    def full(self) -> bool:
        """Return whether the spool is full; no chunk may be offered until one is settled."""
        return len(self._held) >= self._rules.spool_chunks

    def offer(self, chunk: Chunk, version: int) -> None:
        """Put a chunk into the spool and record it.

        Args:
            chunk: the chunk; the spool must not be full.
            version: parameter version that it was collected with.

        Raises:
            UsageError: the learner would refuse it, and every chunk like it.
        """
        steps = chunk.rows.steps
        message = to_message(chunk, self._team, version, self.produced + steps)
        try:
            self._rules.chunk_of(message, self._team)
        except ProtocolError as error:
            raise UsageError(
                f"worker {self._worker} ends, because no learner would take its experience: {error}"
            ) from error
        sealed = message.encode()
        with self._lock:
            number = self._produce(steps)
            self._held.append(_Held(number, version, self.produced, steps, sealed))
        self.offered.set()

    def leave_behind(self, steps: int) -> None:
        """Record an unfinished chunk that nobody would take, as the last one; an audit counts it as lost."""
        with self._lock:
            self._produce(steps)
            self.left_behind += steps

    def _produce(self, steps: int) -> int:
        """Record one more chunk and return its number."""
        self._sequence += 1
        self.produced += steps
        number = self._sequence
        self._history.add(
            Entry("produced", self._worker, self._incarnation, number, number, steps, self.produced, self.flown)
        )
        return number

    @property
    def spooled(self) -> int:
        """Return the number of chunks in the spool."""
        return len(self._held)

    @property
    def in_flight(self) -> int:
        """Return the environment steps that are neither accepted nor rejected yet."""
        return max(self.flown, self.produced) - self.accepted - self.rejected

    def wait_empty(self, timeout: float, meanwhile: Callable[[], None] = lambda: None) -> Loop[bool]:
        """Return the loop that waits until the spool is empty, and returns whether it is.

        Gives up after `timeout` seconds, when the learner takes no more chunks, or after MOST_UNTAKEN untaken requests.

        Args:
            timeout: seconds to wait at most.
            meanwhile: called again and again while this waits.
        """
        self.resend_fast()
        deadline, before = monotonic() + timeout, self.untaken
        while self._held and not (self.learner_closed or self.replaced) and monotonic() < deadline:
            before = min(before, self.untaken)
            if self.untaken - before >= MOST_UNTAKEN:
                break
            meanwhile()
            yield 0.01
        return not self._held

    def resend_fast(self, wanted: bool = True) -> None:
        """Resend an unanswered request after FAST_RESEND_SECONDS, or after the usual patience."""
        self._resends_fast = wanted

    def close(self) -> None:
        """End `deliver`; what is still in the spool is not delivered."""
        self._ended = True
        self.offered.set()
        self._bus.close()

    def deliver(self) -> Loop[None]:
        """Return the loop that delivers what is offered, until a newer start delivers or this one is closed."""
        while not (self.replaced or self._ended):
            with self._lock:
                waiting = list(islice(self._held, MOST_CHUNKS))
            if not waiting:
                yield IDLE_SECONDS
                continue
            try:
                settled = yield from self._deliver(waiting[: fitting([len(held.sealed) for held in waiting])])
            except BusClosedError:
                return
            if not settled:
                self.retries += 1
                yield RETRY_SECONDS

    def _deliver(self, batch: list[_Held]) -> Loop[bool]:
        """Send chunks, oldest first, and drop the settled ones; return whether all are settled."""
        head = batch[0]
        envelope = Envelope("rollout", self._worker, self._incarnation, head.sequence, head.version)
        flown = max(self.flown, batch[-1].produced)
        payload = to_request([held.sealed for held in batch], head.sequence, flown)
        started = monotonic()
        ack, answered = yield from self._request(payload, envelope.encode())
        waited = monotonic() - started
        self.waiting += waited
        self.untaken = 0 if answered or waited >= QUICK_SECONDS else self.untaken + 1
        self.learner_closed = ack is not None and "closed" in ack.verdicts
        self.replaced = ack is not None and "replaced" in ack.verdicts
        if ack is None:
            return False
        settled = [pair for pair in zip(ack.verdicts, ack.reasons, strict=False) if pair[0] in SETTLED]
        if settled:
            # First: with an empty spool, or with the window, the worker may collect.
            self.required_version = ack.required_version
        self.window, self.asked_steps, self.answered_at = ack.window, ack.asked_steps, monotonic()
        for held, (verdict, reason) in zip(batch, settled, strict=False):
            self._settle(held, verdict, reason)
        return len(settled) >= len(batch)

    def _request(self, payload: bytes, attachment: bytes) -> Loop[tuple[ChunkAck | None, bool]]:
        """Return the answer, and whether there was one; a refusal counts."""
        self._resend_after = FAST_RESEND_SECONDS
        try:
            answer = yield from self._bus.asking(self.key, payload, self._patience, attachment, self._resend_now)
            return (None if answer is None else ChunkAck.decode(answer)), answer is not None
        except BusClosedError:
            raise
        except (BusError, ProtocolError) as error:
            self._log_error(str(error))
            return None, True

    def _resend_now(self, waited: float) -> bool:
        usual = ANSWER_SECONDS if self._patience > ANSWER_SECONDS else math.inf
        if waited < (self._resend_after if self._resends_fast else usual):
            return False
        self._resend_after *= 2.0
        self.retries += 1
        return True

    def _log_error(self, text: str) -> None:
        now = monotonic()
        if text != self._last_error or now - self._last_error_at >= SAME_ERROR_SECONDS:
            log(f"worker {self._worker}: {text}")
            self._last_error, self._last_error_at = text, now

    def _settle(self, held: _Held, verdict: str, reason: str) -> None:
        """Record the verdict and remove the oldest chunk."""
        number, steps = held.sequence, held.steps
        with self._lock:
            recorded = {"refused": "refused", "duplicate": "repeated"}.get(verdict, "acknowledged")
            self._history.add(Entry(recorded, self._worker, self._incarnation, number, number, steps))
            self._held.popleft()
            if verdict == "refused":
                self.rejected += steps
                log(f"worker {self._worker}: chunk {number} was refused: {reason}")
            else:
                self.accepted += steps
