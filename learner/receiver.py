"""The learner's front door: every chunk is checked, judged once, queued, and only then acknowledged."""

import queue
import threading
from dataclasses import dataclass

from common import keys
from common.bus import Incoming, Server
from common.chunks import from_message
from common.config import ReplayConfig
from common.errors import ProtocolError, SchemaError
from common.messages import ChunkAck, ChunkMessage, Envelope
from common.process import log
from common.team import TeamSpec
from common.transitions import Chunk
from learner.intake import Intake, WorkerLedger

FULL_SECONDS = 0.005
"""Pause between two looks at a full queue."""
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
        gate: held while a chunk is booked and queued, so that ledger and queue can be seen together.
        required_version: parameter version that a worker must hold before it flies on (lockstep), else 0.
    """

    def __init__(self, server: Server, team: TeamSpec, intake: Intake, replay: ReplayConfig, lockstep: bool) -> None:
        self.arrivals: queue.Queue[Arrival] = queue.Queue(replay.intake_chunks)
        self.intake = intake
        self.malformed = 0
        self.required_version = 0
        self._server, self._team, self._lockstep = server, team, lockstep
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

    def join(self) -> None:
        """Wait for the thread to end; the bus must be closed."""
        self._thread.join()

    def _run(self) -> None:
        for incoming in self._server:
            try:
                self._receive(incoming)
            except ProtocolError as error:
                self.malformed += 1
                self._log(f"dropped a request on {incoming.key}: {error}")
                incoming.refuse(str(error))

    def _receive(self, incoming: Incoming) -> None:
        sender = Envelope.decode(incoming.attachment)
        worker = keys.parse(incoming.key).variables.get("worker")
        if worker != sender.name or sender.sequence < 1:
            raise ProtocolError(f"the envelope names {sender.name[:64]!r}, chunk {sender.sequence}.")
        known = self.intake.workers.get(sender.name)
        if known is not None and sender.incarnation < known.incarnation:
            raise ProtocolError(f"worker {sender.name} has been replaced by a newer start.")
        if self._lockstep and self.intake.workers and known is None:
            raise ProtocolError("a lockstep run has exactly one worker.")
        try:
            message = ChunkMessage.decode(incoming.payload)
            chunk = from_message(message, self._team)
            if chunk.rows.flag.shape[0] > self._most_rows:
                raise SchemaError(f"{chunk.rows.flag.shape[0]} rows at once, more than a replay of {self._most_rows}.")
        except ProtocolError as error:
            self.intake.refuse(sender)
            self._log(f"refused a chunk of worker {sender.name}: {error}")
            incoming.reply(ChunkAck("refused", self.intake.expected(sender), 0, str(error)[:400]).encode())
            return
        status = self.intake.judge(sender, message.oldest)
        if status == "accepted":
            self._queue(incoming, sender, chunk, message)
        else:
            incoming.reply(ChunkAck(status, self.intake.expected(sender), self.required_version, "").encode())

    def _queue(self, incoming: Incoming, sender: Envelope, chunk: Chunk, message: ChunkMessage) -> None:
        owed = incoming if self._lockstep else None
        while True:
            with self.gate:
                if self._closing.is_set():
                    break
                if not self.arrivals.full():
                    # This thread alone puts, so the free place stays free.
                    self.intake.accept(sender, chunk.rows.steps, message.produced, message.flown)
                    ledger = self.intake.workers[sender.name]
                    self.arrivals.put_nowait(Arrival(chunk, sender, ledger, self.intake.closed, owed))
                    if owed is None:
                        incoming.reply(ChunkAck("accepted", ledger.expected, 0, "").encode())
                    return
            self._closing.wait(FULL_SECONDS)
        incoming.reply(ChunkAck("closed", self.intake.expected(sender), 0, "").encode())

    def _log(self, text: str) -> None:
        self._logged += 1
        if self._logged <= LOGGED_REFUSALS:
            log(text)
