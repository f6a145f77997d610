"""What must hold in every simulated run, whatever goes wrong: checked at every event that it is about.

The audit of the histories is the last word; the rest says sooner and more exactly what broke.
"""

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np

from eia_sec.common.actors import imitate
from eia_sec.common.history.history import Entry, read
from eia_sec.common.imitation import LEASE_SECONDS, ImitationEvent
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import (
    ChunkAck,
    Envelope,
    ImitationMessage,
    ParametersMessage,
    ReceiptMessage,
)
from eia_sec.common.transitions import Chunk
from eia_sec.deploy.monitor.audit import audit
from eia_sec.deploy.monitor.run_monitor import RunMonitor
from tests.simulation.network import Request
from tests.simulation.toys import Identity, ToyTrainer
from tests.simulation.world import Process, World

RUN = "simulated"
_ANSWERED = re.compile(r"chunks? ([^/]+)/(\d+)/(\d+)(?: to (\d+))? w(?:as|ere) answered as")


class ViolationError(AssertionError):
    """An invariant does not hold."""


class Judge:
    """Watches a simulation.

    Args:
        world: the clock.

    Attributes:
        produced: every chunk that a worker made, by (worker, start, number).
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self.produced: dict[Identity, Chunk] = {}
        self._leads: dict[Process, tuple[tuple[str, int], float]] = {}
        self._applied: dict[tuple[int, int], ImitationEvent] = {}
        self._published: dict[tuple[int, int], ParametersMessage] = {}
        self._stores: dict[Process, tuple[int, int]] = {}

    def require(self, holds: bool, sentence: str) -> None:
        """Raise ViolationError unless something holds."""
        if not holds:
            raise ViolationError(sentence)

    # A learner's trainer.

    def absorbed(self, trainer: ToyTrainer, chunk: Chunk, version: int, source: str, number: int) -> None:
        """Check a chunk that enters a trainer: it is whole, of an honest worker, new, and not too old."""
        worker, _, start = source.partition("/")
        name = f"chunk {source}/{number}"
        made = self.produced.get((worker, int(start), number))
        self.require(made is not None, f"{name} was never made.")
        assert made is not None
        same = np.array_equal(made.rows.observation, chunk.rows.observation)
        self.require(same and np.array_equal(made.rows.flag, chunk.rows.flag), f"{name} is not what its worker made.")
        before = {(known, at) for known, at, _ in trainer.absorbed}
        self.require((source, number) not in before, f"{name} enters the trainer twice.")
        self.require(version <= trainer.version, f"{name} bears version {version}, which does not exist.")
        config = trainer.config
        if config.learns_on_policy:
            into = trainer.following if trainer.updates_due() else trainer.held
            draining = trainer.process.parts["learner"]._state != "training"
            whole = config.on_policy.iteration_steps
            self.require(into < whole or draining, f"{name} enters an iteration of {whole} steps that holds {into}.")
            age = trainer.version + int(trainer.updates_due() > 0) - version
            age -= sum(newer > version for newer in trainer.by_imitation)
            most = config.on_policy.max_lag_versions
            self.require(age <= most + 1 or draining, f"{name} is {age} versions old where {most} are allowed.")

    def check_learner(self, process: Process) -> None:
        """Check a learner between its steps: its ledger and its trainer agree, and its events came once, in order."""
        learner = process.parts.get("learner")
        if learner is None:
            return
        trainer, receiver = learner.trainer, learner.receiver
        unexplained = receiver.unexplained(trainer.environment_steps)
        self.require(unexplained == 0, f"{process.name} cannot explain {unexplained} steps.")
        wanted = list(range(1, trainer.events + 1))
        self.require(trainer.imitated == wanted, f"{process.name} has applied the events {trainer.imitated}.")
        self.require(
            len(receiver.arrivals.queue) <= receiver.arrivals.maxsize, f"the queue of {process.name} is too long."
        )

    def check_resume(self, process: Process) -> None:
        """Check that a resumed learner knows of every chunk that it had acknowledged before."""
        learner = process.parts["learner"]
        for record in learner._history.before:
            if isinstance(record, Entry) and record.verdict == "accepted":
                known = learner.receiver.ledger.workers.get(record.worker)
                place = (0, 0) if known is None else (known.incarnation, known.expected)
                knows = place > (record.incarnation, record.last)
                self.require(knows, f"{process.name} has forgotten chunk {record.worker}/{record.last}.")

    # What is on the wire.

    def on_reply(self, process: Process, request: Request, payload: bytes) -> None:
        """Check the answers to claims and to events."""
        family = keys.parse(request.key)
        if family.variables.get("verb") == "lead":
            claimant = Envelope.decode(request.attachment)
            name = claimant.name, claimant.incarnation
            if ReceiptMessage.decode(payload).done:
                holder, since = self._leads.get(process, (name, 0.0))
                late = self._world.now - since
                free = holder == name or late >= LEASE_SECONDS
                self.require(free, f"{name[0]} gets the lead {late:.1f} s after {holder[0]}.")
                self._leads[process] = name, self._world.now
        elif request.key == keys.IMITATION.key(RUN):
            receipt = ReceiptMessage.decode(payload)
            if receipt.done and not receipt.reason:
                sender, message = Envelope.decode(request.attachment), ImitationMessage.decode(request.payload)
                holder = self._leads.get(process, (("nobody", 0), 0.0))[0]
                leads = holder == (sender.name, sender.incarnation)
                self.require(leads, f"event {message.event} of {sender.name} is applied while {holder[0]} leads.")
                key = message.epoch, message.event
                self.require(key not in self._applied, f"event {message.event} is applied twice.")
                self._applied[key] = message.to_event()
        elif request.key.startswith(keys.TRANSITION.key(RUN, worker="w")[:-1]):
            ack = ChunkAck.decode(payload)
            self.require(len(ack.verdicts) == len(ack.reasons), "an answer has verdicts without reasons.")

    def on_put(self, process: Process, key: str, payload: bytes) -> None:
        """Note published parameters; check that an announced event was applied."""
        if key == keys.PARAMETERS.key(RUN):
            message = ParametersMessage.decode(payload)
            at = message.epoch, message.version
            self.require(at not in self._published, f"version {message.version} is published twice.")
            self._published[at] = message
        elif key == keys.IMITATION_EVENT.key(RUN):
            announced = ImitationMessage.decode(payload)
            applied = self._applied.get((announced.epoch, announced.event))
            known = applied == announced.to_event()
            self.require(known, f"event {announced.event} is announced, and its learner has not applied it.")

    # The others.

    def check_worker(self, process: Process) -> None:
        """Check a worker's actors: those that its learner published, with the events since, each once."""
        worker = process.parts.get("worker")
        if worker is None:
            return
        store, sender = worker._learner.store, worker.sender
        self.require(sender.spooled <= 3, f"the spool of {process.name} holds {sender.spooled} chunks.")
        self.require(sender.in_flight >= 0, f"{process.name} has {sender.in_flight} steps in flight.")
        if store.actors is None:
            return
        at, before = (store.epoch, store.version), self._stores.get(process, (0, 0))
        fell = at[0] < before[0] and not process.parts.get("may_follow_lower")
        self.require(not fell, f"{process.name} falls from epoch {before[0]} to {at[0]}.")
        back = at[0] == before[0] and at[1] < before[1]
        self.require(not back, f"{process.name} falls from version {before[1]} to {at[1]}.")
        self._stores[process] = at
        message = self._published.get(at)
        self.require(message is not None, f"{process.name} holds version {at[1]} of {at[0]}, which nobody published.")
        assert message is not None
        flat = [part.copy() for part in message.flat]
        for number in range(message.event + 1, store.event + 1):
            event = self._applied.get((store.epoch, number))
            self.require(event is not None, f"{process.name} has imitated event {number}, which nobody applied.")
            assert event is not None
            for part, elite in zip(flat, event.elites, strict=True):
                imitate(part, elite, event.rate)
        same = all(np.array_equal(one, other) for one, other in zip(flat, store.actors.flat, strict=True))
        self.require(same, f"the actors of {process.name} are not those of version {at[1]} with {store.event} events.")

    def check_monitor(self, monitor: RunMonitor) -> None:
        """Check the view: whatever it has heard, the parts of its ledger add up."""
        ledger = monitor.learner_values().get("ledger", {})
        if ledger:
            parts = sum(ledger[name] for name in ("accepted", "lost", "rejected", "in_flight", "unexplained"))
            self.require(ledger["unexplained"] == 0, f"the monitor shows {ledger['unexplained']} unexplained steps.")
            self.require(parts == ledger["produced"], f"the monitor's ledger has parts of {parts}: {ledger}.")
        shown = monitor.snapshot().ledger
        self.require(not ledger or shown.accepted == ledger["accepted"], "the view shows another ledger.")

    # The end.

    def check_end(self, newest: Process, home: Path, histories: Path) -> Any:
        """Audit the run, and compare the audit with the trainer; return the audit."""
        folder = home / "history"
        for path in histories.glob("*.jsonl"):
            shutil.copy(path, folder / path.name)
        found = audit(Path(home))
        left = [sentence for sentence in found.named() if not self._knows_another(sentence, home)]
        self.require(not left, " ".join(left[:3]))
        trainer = newest.parts["learner"].trainer
        rows = sum(self.produced[_identity(entry)].rows.steps for entry in trainer.absorbed)
        self.require(rows == trainer.environment_steps, f"{trainer.environment_steps} steps counted, {rows} absorbed.")
        taken = found.steps["accepted"]
        self.require(taken == rows, f"the histories hold {taken} accepted steps, the trainer {rows}.")
        episodes = sum(len(self.produced[_identity(entry)].episodes) for entry in trainer.absorbed)
        self.require(trainer.episodes <= episodes, f"{trainer.episodes} episodes counted, {episodes} came.")
        return found

    def _knows_another(self, sentence: str, home: Path) -> bool:
        """Return whether the audit's sentence is about chunks that a learner which was replaced had acknowledged.

        Its history is in another folder. The new learner learns of the loss from the worker's next chunk, if one comes.
        """
        about = _ANSWERED.match(sentence)
        if about is None:
            return False
        worker, start, first, last = about[1], int(about[2]), int(about[3]), int(about[4] or about[3])
        known: set[int] = set()
        for path in home.parent.glob("run-*/history/learner.jsonl"):
            for record in read(path)[0] if path.parents[1] != home else ():
                if isinstance(record, Entry) and (record.worker, record.incarnation) == (worker, start):
                    known |= set(record.numbers)
        return known >= set(range(first, last + 1))


def _identity(entry: tuple[str, int, int]) -> Identity:
    worker, _, start = entry[0].partition("/")
    return worker, int(start), entry[1]
