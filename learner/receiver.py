"""The learner's front door: every chunk is checked, judged once, queued, and only then acknowledged."""

import queue
import threading
from dataclasses import dataclass
from typing import Any

from common import keys
from common.bus import Incoming, Server
from common.chunks import from_message
from common.config import ReplayConfig
from common.errors import ProtocolError, SchemaError
from common.history import Entry, History
from common.messages import ChunkAck, ChunkMessage, Envelope
from common.process import log
from common.team import TeamSpec
from common.transitions import Chunk
from learner.intake import Intake, WorkerLedger
from learner.offenders import CUT_SECONDS, Offenders
from learner.tarpit import Tarpit

FULL_SECONDS = 0.005
"""Pause between two looks at a full queue."""
DAMAGED_TRIES = 8
"""Times that one chunk may arrive damaged before it is refused for good: its worker makes it so."""
LOGGED_REFUSALS = 20
"""Refusals that are logged one by one; all are counted."""


@dataclass(frozen=True)
class Arrival:
    """An accepted chunk on its way into replay.

    Attributes:
        chunk: the experience.
        sender: who sent it, with which parameter version.
        ledger: the worker's account once this chunk is in.
        closed: the account of all earlier incarnations then.
        incoming: the request, when its answer is still owed (lockstep), else None.
    """

    chunk: Chunk
    sender: Envelope
    ledger: WorkerLedger
    closed: WorkerLedger
    incoming: Incoming | None


class Receiver:
    """Takes chunks from a server in a thread of its own and puts them into a bounded queue.

    The queue is the backpressure: while it is full, answers are late, and workers wait for them.

    Attributes:
        arrivals: the queue.
        intake: deduplication and ledger.
        malformed: requests that could not even be attributed to a worker.
        offenders: who sends what brings nothing.
        tarpit: requests of those who are cut off; whoever owns the receiver calls its `release` now and then.
        server: where chunks come in.
        gate: held while a chunk is booked and queued, so that ledger and queue can be seen together.
        required_version: parameter version that a worker must hold before it flies on (lockstep), else 0.
        version: the newest parameter version; `replay.max_lag_versions` counts from it.

    Args:
        server: where chunks come in.
        team: what they must fit.
        intake: deduplication and ledger; it is the receiver's from now on.
        replay: bounds.
        lockstep: whether the learner answers itself, when it has trained.
        history: where each verdict is written before it is told.
    """

    def __init__(
        self,
        server: Server,
        team: TeamSpec,
        intake: Intake,
        replay: ReplayConfig,
        lockstep: bool,
        history: History | None = None,
    ) -> None:
        self.arrivals: queue.Queue[Arrival] = queue.Queue(replay.intake_chunks)
        self.intake = intake
        self.malformed = 0
        self.offenders, self.tarpit = Offenders(), Tarpit()
        self.required_version = self.version = 0
        self._history = history or History(None)
        self._damaged: dict[str, tuple[int, int, int]] = {}
        self._most_lag = replay.max_lag_versions
        self.server, self._team, self._lockstep = server, team, lockstep
        self._most_rows = replay.capacity
        self._closing = threading.Event()
        self.gate = threading.Lock()
        self._logged = 0
        self._thread = threading.Thread(target=self._run, name="receiver", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Take no more chunks; every accepted one is in the queue when this returns."""
        with self.gate:
            self._closing.set()

    @property
    def alive(self) -> bool:
        """Whether chunks are still taken."""
        return self._thread.is_alive()

    def figures(self) -> dict[str, Any]:
        """Return what a report says of the front door."""
        return {
            "queue": self.arrivals.qsize(),
            "malformed": self.malformed + self.server.wild,
            "malformed_by": self.offenders.counts(),
            "turned_away": self.tarpit.turned_away,
        }

    def join(self) -> None:
        """Take no more chunks and wait for the thread to end; the bus must be closed.

        Whoever joins has stopped emptying the queue, so a thread that waits for room there would wait for ever.
        """
        self.close()
        self._thread.join()

    def _run(self) -> None:
        for incoming in self.server:
            try:
                self._receive(incoming)
            except ProtocolError as error:
                self.malformed += 1
                self._log(f"dropped a request on {incoming.key}: {error}")
                incoming.refuse(str(error))

    def _receive(self, incoming: Incoming) -> None:
        worker = keys.parse(incoming.key).variables.get("worker", "")
        if (refusal := self.offenders.refusal(worker)) is not None:
            self.tarpit.hold(incoming, refusal)
            return
        try:
            sender = Envelope.decode(incoming.attachment)
            if (sender.role, sender.name) != ("rollout", worker) or sender.sequence < 1:
                raise ProtocolError(f"the envelope names {sender.role[:16]} {sender.name[:64]!r}, {sender.sequence}.")
        except ProtocolError as error:
            self._bad(worker, str(error))
            raise
        known = self.intake.workers.get(sender.name)
        if known is not None and sender.incarnation < known.incarnation:
            raise ProtocolError(f"worker {sender.name} has been replaced by a newer start.")
        if self._lockstep and self.intake.workers and known is None:
            raise ProtocolError("a lockstep run has exactly one worker.")
        try:
            message = ChunkMessage.decode(incoming.payload)
        except ProtocolError as error:
            self._send_again(incoming, sender, error)
            return
        self._judge(incoming, sender, message)

    def _judge(self, incoming: Incoming, sender: Envelope, message: ChunkMessage) -> None:
        status = self.intake.judge(sender, message.oldest)
        if status != "accepted":
            if status == "duplicate":
                self._tell("duplicate", sender, 1)
            self._bad(sender.name, f"chunk {sender.sequence} is a {status}.")
            self._answer(incoming, sender, status)
            return
        try:
            chunk = from_message(message, self._team)
            if chunk.rows.flag.shape[0] > self._most_rows:
                raise SchemaError(f"{chunk.rows.flag.shape[0]} rows at once, more than a replay of {self._most_rows}.")
        except ProtocolError as error:
            self._bad(sender.name, str(error))
            self._refuse(incoming, sender, error)
            return
        lag = self.version - sender.version
        if 0 < self._most_lag < lag:
            steps = chunk.rows.steps
            lost = self.intake.refuse_aged(sender, steps, message.produced, message.flown)
            self._tell("missing", sender, lost)
            self._tell("refused", sender, steps, message)
            self._answer(incoming, sender, "refused", f"its policy is {lag} versions old, more than {self._most_lag}.")
            return
        self._queue(incoming, sender, chunk, message)

    def _send_again(self, incoming: Incoming, sender: Envelope, error: ProtocolError) -> None:
        """Ask for an unreadable frame once more, without spending its number; refuse it when that goes on.

        A number that is not the next one is never spent here: the worker may still hold those before it.
        """
        self.intake.note_damaged(sender)
        self._bad(sender.name, str(error))
        self._log(f"a chunk of worker {sender.name} came damaged: {error}")
        expected = self.intake.expected(sender)
        if sender.sequence < expected:
            self._answer(incoming, sender, "duplicate")
            return
        start, sequence, times = self._damaged.get(sender.name, (0, 0, 0))
        times = times + 1 if (start, sequence) == (sender.incarnation, sender.sequence) else 1
        self._damaged[sender.name] = (sender.incarnation, sender.sequence, times)
        if sender.sequence == expected and (times >= DAMAGED_TRIES or isinstance(error, SchemaError)):
            self._refuse(incoming, sender, error)
            return
        self._answer(incoming, sender, "damaged", str(error))

    def _refuse(self, incoming: Incoming, sender: Envelope, error: ProtocolError) -> None:
        self._damaged.pop(sender.name, None)
        self.intake.refuse(sender)
        self._tell("refused", sender, 0)
        self._log(f"refused a chunk of worker {sender.name}: {error}")
        self._answer(incoming, sender, "refused", str(error))

    def _answer(self, incoming: Incoming, sender: Envelope, status: str, reason: str = "") -> None:
        version = 0 if status == "refused" else self.required_version
        incoming.reply(ChunkAck(status, self.intake.expected(sender), version, reason[:400]).encode())

    def _tell(self, verdict: str, sender: Envelope, steps: int, message: ChunkMessage | None = None) -> None:
        """Write a verdict into the history; of missing steps only when there are any."""
        if verdict == "missing" and steps == 0:
            return
        produced, flown = (message.produced, message.flown) if message is not None else (0, 0)
        number = sender.sequence
        self._history.add(Entry(verdict, sender.name, sender.incarnation, number, number, steps, produced, flown))

    def _queue(self, incoming: Incoming, sender: Envelope, chunk: Chunk, message: ChunkMessage) -> None:
        owed = incoming if self._lockstep else None
        while True:
            with self.gate:
                if self._closing.is_set():
                    break
                if not self.arrivals.full():
                    # This thread alone puts, so the free place stays free.
                    steps = chunk.rows.steps
                    lost = self.intake.accept(sender, steps, message.produced, message.flown)
                    self._tell("missing", sender, lost)
                    self._tell("accepted", sender, steps, message)
                    ledger = self.intake.workers[sender.name]
                    self.offenders.good(sender.name)
                    self.arrivals.put_nowait(Arrival(chunk, sender, ledger, self.intake.closed, owed))
                    if owed is None:
                        incoming.reply(ChunkAck("accepted", ledger.expected, 0, "").encode())
                    return
            self._closing.wait(FULL_SECONDS)
        incoming.reply(ChunkAck("closed", self.intake.expected(sender), 0, "").encode())

    def _bad(self, worker: str, reason: str) -> None:
        if self.offenders.bad(worker, reason):
            log(f"{self.offenders.refusal(worker)}; looked at again in {CUT_SECONDS:.0f} s.")

    def _log(self, text: str) -> None:
        self._logged += 1
        if self._logged <= LOGGED_REFUSALS:
            log(text)
