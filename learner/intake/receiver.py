"""Receives chunks: each is checked, booked once, queued, and only then acknowledged."""

import queue
import threading
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.errors import ProtocolError, SchemaError
from eia_sec.common.history.history import Entry, History
from eia_sec.common.incarnation import plausible
from eia_sec.common.log import log
from eia_sec.common.loops import Loop
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.chunk_messages import MOST_COUNT, SETTLED, from_request
from eia_sec.common.protocol.chunk_rules import ChunkRules
from eia_sec.common.protocol.frame import Data
from eia_sec.common.protocol.messages import ChunkAck, ChunkMessage, DeliveryMessage, Envelope
from eia_sec.common.team import TeamSpec
from eia_sec.common.transitions import Chunk
from eia_sec.common.transport.bus import Incoming, Server
from eia_sec.learner.intake.arrival import Arrival, OwedAnswer
from eia_sec.learner.intake.episode_tracker import EpisodeTracker, provable
from eia_sec.learner.intake.iteration_room import IterationRoom, Terms
from eia_sec.learner.intake.ledger import Ledger, WorkerLedger
from eia_sec.learner.intake.limits import IntakeLimits
from eia_sec.learner.intake.peer_penalties import BLOCK_SECONDS, PeerPenalties
from eia_sec.learner.intake.throttle import Throttle

FULL_SECONDS: Final = 0.001
"""Pause between two checks of a full queue."""
DAMAGED_TRIES: Final = 8
"""Times that one chunk may arrive damaged before it is refused: the damage is then the worker's, not the network's."""
MOST_WORKERS: Final = 65_536
"""Most workers with accounts, past ones included; every checkpoint holds all accounts."""
LOGGED_REFUSALS: Final = 20
"""Refusals that are logged one by one; all are counted."""
REASON: Final = 400
"""Most characters of a reason in an answer."""
Verdict = tuple[str, str]
"""The verdict on a chunk, see `ChunkAck`, and the reason if it was not accepted."""
Counts = tuple[int, int, int]
"""Environment steps in a chunk, produced by its start (this chunk included), and flown by its start."""
TAKEN: Final[Verdict] = ("accepted", "")
WORTH_LOOKING: Final = frozenset(("accepted", "closed", "refused", "damaged"))
"""A request with none of these verdicts counts against its sender; bad chunks are counted one by one."""


class Receiver:
    """Receives chunks and puts them into a bounded queue; `receive` is a loop for a thread of its own.

    The queue applies backpressure: while it is full, answers are late, and workers wait for them.

    Attributes:
        arrivals: the queue.
        ledger: deduplication and the account of every worker.
        malformed: requests that belong to no worker, or whose envelope or number of chunks is wrong.
        replaced: requests from starts that a newer start of the same worker has replaced.
        uncounted_episodes: finished episodes that did not count, because this learner has not received all their steps.
        repeats: whether the worker of a lockstep run has been restarted, and would repeat its first episodes.
        peer_penalties: counts of invalid requests by worker.
        throttle: requests of blocked workers; the receiver's owner must call its `release` regularly.
        server: where chunks arrive.
        gate: lock held while a chunk is booked and queued, so that ledger and queue can be read together.
        dealt_with: set when a request has been dealt with, or waits for room. It is not set for each chunk: two threads
            that exchange Python's lock for every chunk spend more time on that than on chunks.
        failed: whether `receive` has ended with an error, so that no more chunks can be received.
        required_version: parameter version that a worker must hold before it continues (lockstep), else 0.
        room: the steps that the running iteration still takes in; chunks beyond them wait.

    Args:
        server: where chunks arrive.
        team: layout of their rows.
        rules: checks of chunks against the run's configuration.
        ledger: deduplication and the account of every worker; the receiver owns it from now on.
        limits: the size of the queue and the largest version lag.
        lockstep: whether the learner itself answers, after it has trained; a request then holds one chunk.
        history: where each verdict is written before it is sent.
        version: the newest parameter version so far.
        resumed: whether there was a learner of this run before, which may still be alive and take chunks.
    """

    def __init__(
        self,
        server: Server,
        team: TeamSpec,
        rules: ChunkRules,
        ledger: Ledger,
        limits: IntakeLimits,
        lockstep: bool,
        history: History | None = None,
        version: int = 0,
        *,
        resumed: bool = False,
    ) -> None:
        self.arrivals: queue.Queue[Arrival] = queue.Queue(limits.chunks)
        self.server, self.ledger = server, ledger
        self.malformed = self.replaced = self.uncounted_episodes = 0
        self.repeats = False
        self.peer_penalties, self.throttle = PeerPenalties(), Throttle()
        self.required_version = 0
        self.gate = threading.Lock()
        self.room = IterationRoom(limits, version, self.gate)
        self._history = history or History(None)
        self._damaged: dict[str, tuple[int, int, int]] = {}
        self._team, self._rules, self._lockstep, self._resumed = team, rules, lockstep, resumed
        self._episodes = EpisodeTracker(rules)
        self._met: dict[str, int] = {}
        self.dealt_with, self._closing, self.failed = threading.Event(), False, False
        self._logged = 0
        self._owed: OwedAnswer | None = None

    def close(self) -> None:
        """Accept no more chunks; every accepted one is in the queue when this returns."""
        with self.gate:
            self._closing = True
        self.room.lift()

    def require_version(self, version: int) -> None:
        """Let workers continue only with this version or a later one (lockstep)."""
        self.required_version = version

    def unexplained(self, absorbed: int) -> int:
        """Return the steps that the ledger cannot explain or that replay and queue lack; 0 unless there is a defect.

        Both are absolute values, so they cannot cancel each other.

        Args:
            absorbed: environment steps that have left the queue for replay.
        """
        with self.gate:
            accepted, unclosed = self.ledger.totals()["accepted"], self.ledger.unexplained()
            queued = sum(arrival.chunk.rows.steps for arrival in list(self.arrivals.queue))
        return abs(int(accepted - absorbed - queued)) + unclosed

    def metrics(self) -> dict[str, Any]:
        """Return the metrics of the intake."""
        return {
            "queue": self.arrivals.qsize(),
            "malformed": self.malformed + self.server.wild,
            "replaced": self.replaced,
            "malformed_by": self.peer_penalties.counts(),
            "turned_away": self.throttle.turned_away,
            "uncounted_episodes": self.uncounted_episodes,
            "flights_given_up": self.room.given_up,
        }

    def receive(self) -> Loop[None]:
        """Return the loop that deals with one request after the other, until the bus is closed.

        It waits in the server, and pauses while there is no room. Who no longer empties the queue must call `close`.
        """
        try:
            for incoming in self.server:
                try:
                    yield from self._receive(incoming)
                except ProtocolError as error:
                    self.malformed += 1
                    self._log(f"dropped a request on {incoming.key}: {error}")
                    incoming.refuse(str(error))
                if not self.arrivals.empty():
                    self.dealt_with.set()
        except Exception:
            self.failed = True
            raise

    def _receive(self, incoming: Incoming) -> Loop[None]:
        worker = keys.parse(incoming.key).variables.get("worker", "")
        if (refusal := self.peer_penalties.refusal(worker)) is not None:
            self.throttle.hold(incoming, refusal)
            return
        sender = self._identified(incoming, worker)
        if sender.incarnation < self.ledger.newest_incarnation(worker):
            # No penalty here: it would affect the newer start, which has the same name.
            self.replaced += 1
            incoming.reply(ChunkAck(("replaced",), ("a newer start of this worker delivers now.",), 1, 0).encode())
            return
        if (ended := self.ledger.meet(sender)) is not None and ended.in_flight:
            self._record_undelivered(sender.name, ended)
        try:
            delivery, parts = from_request(incoming.payload)
        except ProtocolError as error:
            self._answer(incoming, sender, [self._send_again(sender, error)])
            return
        if self._lockstep and len(parts) > 1:
            raise ProtocolError("a lockstep run accepts one chunk at a time.")
        verdicts: list[Verdict] = []
        for index, data in enumerate(parts):
            numbered = replace(sender, sequence=sender.sequence + index)
            verdicts.append((yield from self._judge(numbered, delivery, data, incoming)))
            if verdicts[-1][0] not in SETTLED:
                break
        if not (self._lockstep and self._owes(incoming, sender, verdicts[0])):
            self._answer(incoming, sender, verdicts)

    def _owes(self, incoming: Incoming, sender: Envelope, verdict: Verdict) -> bool:
        """Return whether the learner answers a request in lockstep: its chunk is new, or is still being trained on."""
        again = verdict[0] == "duplicate" and sender.sequence == self.ledger.expected(sender) - 1
        return verdict == TAKEN or (again and self._owed is not None and self._owed.renew(incoming))

    def _identified(self, incoming: Incoming, worker: str) -> Envelope:
        """Return a request's sender; raise ProtocolError when it may not send here."""
        try:
            sender = Envelope.decode(incoming.attachment)
            if (sender.role, sender.name) != ("rollout", worker) or not 1 <= sender.sequence <= MOST_COUNT:
                raise ProtocolError(f"the envelope names {sender.role[:16]} {sender.name[:64]!r}, {sender.sequence}.")
            if not plausible(sender.incarnation, self.ledger.newest_incarnation(worker)):
                raise ProtocolError(f"the incarnation {sender.incarnation} is not plausible.")
        except ProtocolError as error:
            self._bad(worker, str(error))
            raise
        known = self.ledger.workers.get(sender.name)
        if self._lockstep and known is None and any(worker.accepted for worker in self.ledger.workers.values()):
            raise ProtocolError("a lockstep run has exactly one worker.")
        if self._lockstep and known is not None and known.accepted and sender.incarnation > known.incarnation:
            self.repeats = True
            raise ProtocolError("a lockstep run ends with its worker, which would repeat its first episodes.")
        if known is None and len(self.ledger.workers) >= MOST_WORKERS:
            raise ProtocolError(f"the learner already has accounts of {MOST_WORKERS} workers.")
        return sender

    def _judge(self, sender: Envelope, delivery: DeliveryMessage, data: Data, incoming: Incoming) -> Loop[Verdict]:
        """Check one chunk of a delivery, and book and queue it if it is valid.

        Args:
            sender: who sent it, with the chunk's own number.
            delivery: the delivery that it arrived in.
            data: its frame.
            incoming: the request, which the learner itself answers in lockstep.
        """
        try:
            message = ChunkMessage.decode(data)
        except ProtocolError as error:
            return self._send_again(sender, error)
        # A worker holds each chunk until a learner settles it. If this is the only one, none can be missing. But
        # one that was thought dead may settle chunks beside its successor, at any time.
        met = self._met.get(sender.name) == sender.incarnation and not self._resumed
        status = self.ledger.judge(sender, 0 if met else delivery.oldest)
        if status != "accepted":
            if status == "duplicate":
                self._record("duplicate", sender, 1)
            return status, ""
        try:
            chunk = self._rules.chunk_of(message, self._team)
            before, follows = self.ledger.produced_before(sender)
            counts = chunk.rows.steps, message.produced, delivery.flown
            self._rules.check_counts(sender, *counts, before, follows=follows)
            since = self._episodes.check(sender, chunk)
        except ProtocolError as error:
            self._bad(sender.name, str(error))
            return self._refuse(sender, error)
        if not (yield from self._await_room()):
            return "closed", ""
        with self.gate:
            sender = replace(sender, version=self.room.version_of(message.version))
            refusal = self.room.refusal(sender.version)
        if refusal:
            self._record_taken("refused", sender, counts, self.ledger.refuse_aged(sender, *counts))
            self._settle(sender, since)
            return "refused", refusal
        owed = OwedAnswer(incoming) if self._lockstep else None
        verdict = yield from self._queue(sender, chunk, counts, owed)
        if verdict == TAKEN:
            self._settle(sender, since)
        return verdict

    def _await_room(self) -> Loop[bool]:
        """Wait until the running iteration takes in a chunk; return False if no more chunks are accepted."""
        while True:
            with self.gate:
                if self._closing:
                    return False
                if self.room.is_open():
                    return True
            self.dealt_with.set()
            yield FULL_SECONDS

    def _settle(self, sender: Envelope, since: NDArray[np.int64]) -> None:
        """Remember the worker of a whole chunk, and its environments' running episodes."""
        self._met[sender.name] = sender.incarnation
        self._episodes.follow(sender, since)

    def _send_again(self, sender: Envelope, error: ProtocolError) -> Verdict:
        """Ask for an unreadable frame again without using up its number; refuse it after DAMAGED_TRIES.

        A whole frame whose fields are wrong is refused at once.
        Only the expected number is ever used up here: the worker may still hold the chunks before a later one.
        """
        self.ledger.note_damaged(sender)
        self._log(f"a chunk of worker {sender.name} arrived damaged: {error}")
        expected = self.ledger.expected(sender)
        if sender.sequence < expected:
            self._record("duplicate", sender, 1)  # the answer is the same as for a whole copy
            return "duplicate", ""
        self._bad(sender.name, str(error))
        start, sequence, times = self._damaged.get(sender.name, (0, 0, 0))
        times = times + 1 if (start, sequence) == (sender.incarnation, sender.sequence) else 1
        self._damaged[sender.name] = (sender.incarnation, sender.sequence, times)
        if sender.sequence == expected and (times >= DAMAGED_TRIES or isinstance(error, SchemaError)):
            return self._refuse(sender, error)
        return "damaged", str(error)[:REASON]

    def _refuse(self, sender: Envelope, error: ProtocolError) -> Verdict:
        self._damaged.pop(sender.name, None)
        if sender.sequence > self.ledger.expected(sender):
            # The next valid chunk shows how many steps are missing; that some are missing is known now.
            self._record("missing", sender, 0)
        self.ledger.refuse(sender)
        self._met[sender.name] = sender.incarnation
        self._record("refused", sender, 0)
        self._log(f"refused a chunk of worker {sender.name}: {error}")
        return "refused", str(error)[:REASON]

    def _answer(self, incoming: Incoming, sender: Envelope, verdicts: list[Verdict]) -> None:
        """Send the verdicts, or let them wait for room; a request that achieved nothing counts against its sender."""
        names, reasons = zip(*verdicts, strict=True)
        if not (set(names) & WORTH_LOOKING or self.room.holds(sender.name)):
            self._bad(sender.name, f"chunk {sender.sequence} is a {names[0]}.")
        expected = self.ledger.expected(sender)
        incoming.payload = b""  # the answer may be held back for long

        def reply(terms: Terms) -> None:
            incoming.reply(ChunkAck(names, reasons, expected, *terms).encode())

        if self._lockstep:
            reply(Terms(0 if names[-1] == "refused" else self.required_version))
        elif names[-1] in SETTLED:
            self.room.answer(sender.name, reply)
        else:
            reply(self.room.terms)

    def _record(self, verdict: str, sender: Envelope, steps: int, produced: int = 0, flown: int = 0) -> None:
        """Write a verdict into the history."""
        number = sender.sequence
        self._history.add(Entry(verdict, sender.name, sender.incarnation, number, number, steps, produced, flown))

    def _record_taken(self, verdict: str, sender: Envelope, counts: Counts, lost: int) -> None:
        """Write the verdict on a whole chunk into the history, after any lost steps before it."""
        if lost:
            self._record("missing", sender, lost)
            self._log(f"worker {sender.name} can no longer deliver {lost} steps from before chunk {sender.sequence}.")
        self._record(verdict, sender, *counts)

    def _record_undelivered(self, worker: str, ended: WorkerLedger) -> None:
        """Write into the history what a start that a newer one replaced had flown and never delivered."""
        number, steps, flown = ended.expected, ended.in_flight, ended.flown
        self._history.add(Entry("undelivered", worker, ended.incarnation, number, number, steps, flown, flown))
        self._log(f"worker {worker} was started again and never delivered the last {steps} steps of its earlier start.")

    def _queue(self, sender: Envelope, chunk: Chunk, counts: Counts, owed: OwedAnswer | None) -> Loop[Verdict]:
        """Book a chunk and put it into the queue, as soon as there is room."""
        while True:
            with self.gate:
                if self._closing:
                    return "closed", ""
                if not self.arrivals.full():
                    # Only this thread adds to the queue, so there is still room.
                    counted = provable(chunk.episodes, self.ledger.room(sender) + counts[0])
                    if uncounted := len(chunk.episodes) - len(counted):
                        self.uncounted_episodes += uncounted
                        self._log(f"{uncounted} episodes of worker {sender.name} do not count: their steps never came.")
                    lost = self.ledger.accept(sender, *counts, counted=sum(episode.steps for episode in counted))
                    self._record_taken("accepted", sender, counts, lost)
                    self.peer_penalties.good(sender.name)
                    self._owed = owed
                    chunk = replace(chunk, episodes=counted)
                    self.room.take(counts[0])
                    self.arrivals.put_nowait(Arrival(chunk, sender, self.ledger.now(), owed))
                    return TAKEN
            self.dealt_with.set()
            yield FULL_SECONDS

    def _bad(self, worker: str, reason: str) -> None:
        if self.peer_penalties.bad(worker, reason):
            log(f"{self.peer_penalties.refusal(worker)}; looked at again in {BLOCK_SECONDS:.0f} s.")

    def _log(self, text: str) -> None:
        self._logged += 1
        if self._logged <= LOGGED_REFUSALS:
            log(text)
