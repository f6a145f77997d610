"""The ledger: it books each chunk once, in order, and accounts for every environment step."""

import heapq
import threading
from dataclasses import asdict, dataclass, fields, replace
from typing import Any, Final, Literal, NamedTuple

from eia_sec.common.errors import CheckpointError
from eia_sec.common.protocol.messages import Envelope

Status = Literal["accepted", "duplicate", "gap"]
ROWS: Final = 16
"""Most workers that a report lists one by one; it sums the others."""
OTHERS: Final = "(others)"
"""Name of that sum; no worker can have it."""
_REPORTED: Final = (
    "accepted",
    "lost",
    "claimed",
    "rejected",
    "in_flight",
    "unexplained",
    "duplicates",
    "refused",
    "aged",
    "damaged",
)


@dataclass(frozen=True)
class WorkerLedger:
    """The account of one worker's present start (incarnation), in environment steps and chunks.

    The worker reports `flown` and `produced`. They are never computed from booked steps, so the two sides can be
    compared.

    Attributes:
        incarnation: number of the worker's start.
        expected: sequence number of the next chunk.
        flown: most steps that the worker has reported as flown.
        produced: steps up to and including the last booked chunk, as the worker counts; equal to `flown` once the start
            has ended.
        accepted: steps that entered replay.
        lost: steps that were produced and can no longer arrive.
        claimed: those of them in chunks that the worker skipped. Only its word says that it ever flew them.
        rejected: steps in chunks that were refused.
        duplicates: chunks that came again.
        refused: chunks that were refused.
        aged: those of them that were refused because their policy was too old.
        damaged: frames that could not be read; they are sent again.
        delivered: steps of whole chunks, whatever became of them; a learner that resumes knows of them, too.
        counted: steps of the finished episodes that counted for the run, never more than were delivered.
        pending_rejected: whether the next gap in `produced` is a refused chunk's.
        pending_gap: whether numbers were left out since the last chunk that was taken.
        earlier: the sums of all earlier starts of the worker, or None before there was one.
    """

    incarnation: int
    expected: int = 1
    flown: int = 0
    produced: int = 0
    accepted: int = 0
    lost: int = 0
    claimed: int = 0
    rejected: int = 0
    duplicates: int = 0
    refused: int = 0
    aged: int = 0
    damaged: int = 0
    delivered: int = 0
    counted: int = 0
    pending_rejected: bool = False
    pending_gap: bool = False
    earlier: "WorkerLedger | None" = None

    @property
    def in_flight(self) -> int:
        """Steps that the worker reports after the last booked chunk."""
        return self.flown - self.produced

    @property
    def unexplained(self) -> int:
        """Steps up to the last booked chunk that no entry covers; negative when too many were booked."""
        return self.produced - self.accepted - self.lost - self.rejected

    def given_up(self) -> "WorkerLedger":
        """Return the account of a start that has ended: steps that have not arrived are lost."""
        return replace(self, lost=self.lost + self.in_flight, produced=self.flown)

    def sums(self) -> dict[str, int]:
        """Return the account over all starts; see `Ledger.totals`."""
        return _summed([self] if self.earlier is None else [self, self.earlier])


class LedgerSnapshot(NamedTuple):
    """The ledger at one instant.

    Attributes:
        closed: the sum over all starts that have ended.
        workers: the accounts of the present starts, by worker.
    """

    closed: WorkerLedger
    workers: dict[str, WorkerLedger]

    def state(self) -> dict[str, Any]:
        """Return what a checkpoint needs."""
        return {"closed": asdict(self.closed), "workers": {name: asdict(w) for name, w in self.workers.items()}}


class Ledger:
    """Deduplication by (worker, incarnation, sequence), and the ledger of all workers.

    A worker sends its chunks in sequence and repeats each until it is answered. So a number below the expected one is a
    duplicate. A number above it is a gap, which the worker closes by sending again. If the worker no longer holds the
    missing chunks, their steps are counted as lost. When a new start of a worker appears, the steps that its previous
    start reported and never delivered are lost as well.
    """

    def __init__(self) -> None:
        self.workers: dict[str, WorkerLedger] = {}
        self.closed = WorkerLedger(0)
        self._switch = threading.Lock()

    def meet(self, sender: Envelope) -> WorkerLedger | None:
        """Begin the account of a worker's start, unless there is one; return that of the start which it ends, if any.

        The steps that are in flight in the account returned are lost.
        """
        before = self.workers.get(sender.name)
        return before if self._ledger(sender) is not before and before is not None else None

    def judge(self, sender: Envelope, oldest: int) -> Status:
        """Return a chunk's status without accepting it; a duplicate is counted.

        Args:
            sender: who sent it, with the chunk's own number.
            oldest: number of the oldest chunk that the worker still holds; earlier ones can never arrive.
        """
        ledger = self._ledger(sender)
        if sender.sequence < ledger.expected:
            self.workers[sender.name] = replace(ledger, duplicates=ledger.duplicates + 1)
            return "duplicate"
        if sender.sequence > ledger.expected and oldest < sender.sequence:
            return "gap"
        return "accepted"

    def accept(self, sender: Envelope, steps: int, produced: int, flown: int, counted: int = 0) -> int:
        """Book an accepted chunk.

        Args:
            sender: who sent it.
            steps: environment steps in it.
            produced: steps that its start has produced, this chunk included.
            flown: steps that its start has flown.
            counted: steps of the episodes that end in it and count for the run.

        Returns:
            Steps before it that are now known to be lost.
        """
        return self._spend(sender, steps, produced, flown, accepted=steps, counted=counted)

    def room(self, sender: Envelope) -> int:
        """Return how many delivered steps of a worker's start no finished episode has used yet."""
        ledger = self._ledger(sender)
        return ledger.delivered - ledger.counted

    def lose(self, sender: Envelope, steps: int, produced: int, flown: int) -> None:
        """Book as lost a chunk that an earlier start of the learner accepted after its last checkpoint."""
        self._spend(sender, steps, produced, flown, lost=steps)

    def refuse(self, sender: Envelope, chunks: int = 1) -> None:
        """Book a refused chunk of unknown content; its number is used up.

        Args:
            sender: who sent it, with the number of the last chunk.
            chunks: number of consecutive refused chunks to book at once.
        """
        ledger = self._ledger(sender)
        self.workers[sender.name] = replace(
            ledger,
            expected=max(ledger.expected, sender.sequence + 1),
            refused=ledger.refused + chunks,
            # After a gap it is unknown which missing steps were in refused chunks, so all count as lost.
            pending_gap=(gap := ledger.pending_gap or sender.sequence - chunks + 1 > ledger.expected),
            pending_rejected=not gap,
        )

    def refuse_aged(self, sender: Envelope, steps: int, produced: int, flown: int, chunks: int = 1) -> int:
        """Book chunks that were refused because their policy is too old; return the lost steps before them."""
        return self._spend(sender, steps, produced, flown, rejected=steps, refused=chunks, aged=chunks)

    def note_damaged(self, sender: Envelope) -> None:
        """Count a damaged frame; its number stays free, so the chunk can arrive again."""
        ledger = self._ledger(sender)
        self.workers[sender.name] = replace(ledger, damaged=ledger.damaged + 1)

    def newest_incarnation(self, worker: str) -> int:
        """Return the greatest known incarnation of a worker, or 0; any thread may call this."""
        ledger = self.workers.get(worker)
        return 0 if ledger is None else ledger.incarnation

    def expected(self, sender: Envelope) -> int:
        """Return the next sequence number that this sender should use."""
        return self._ledger(sender).expected

    def produced_before(self, sender: Envelope) -> tuple[int, bool]:
        """Return the steps that a start had produced with its last booked chunk, and whether that is the one before."""
        ledger = self._ledger(sender)
        follows = sender.sequence == ledger.expected and not (ledger.pending_rejected or ledger.pending_gap)
        return ledger.produced, follows

    def totals(self) -> dict[str, int]:
        """Return the sums over all workers and all their starts.

        produced (flown, by the workers' own count) = accepted + lost + rejected + in_flight + unexplained, each in
        environment steps; duplicates, refused, aged and damaged in chunks.
        """
        return self.accounts(0)[0]

    def unexplained(self) -> int:
        """Return how many steps the accounts leave unexplained.

        Errors of opposite sign do not cancel, but for those of starts that have ended, which share one account.
        """
        closed, workers = self.now()
        return sum(abs(part.unexplained) for part in (closed, *workers.values()))

    def accounts(self, rows: int = ROWS) -> tuple[dict[str, int], dict[str, dict[str, int]]]:
        """Return the totals and their parts: the accounts of single workers, and the sum of the others.

        Workers with the most lost and rejected steps come first, then those that produced most. The sum is named
        OTHERS, and its `workers` is the number of workers in it. The parts add up to the totals exactly.

        Args:
            rows: most workers that are listed one by one.
        """
        closed, workers = self.now()
        totals = _summed([closed, *workers.values()])
        every = ((name, ledger.sums()) for name, ledger in workers.items())
        chosen = dict(heapq.nsmallest(rows, every, key=_trouble_first)) if rows else {}
        rest = {name: total - sum(part[name] for part in chosen.values()) for name, total in totals.items()}
        hidden = len(workers) - len(chosen)
        if hidden or any(rest.values()):
            chosen[OTHERS] = {"workers": hidden, **rest}
        return totals, chosen

    def state(self) -> dict[str, Any]:
        """Return what a checkpoint needs."""
        return self.now().state()

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a checkpoint's ledger; raise CheckpointError when it is malformed."""
        try:
            self.closed = _account(state["closed"])
            self.workers = {str(name): _rebuilt(entry) for name, entry in state["workers"].items()}
        except (KeyError, TypeError, AttributeError, ValueError) as error:
            raise CheckpointError(f"the checkpoint's ledger cannot be read: {error}") from error

    def _spend(self, sender: Envelope, steps: int, produced: int, flown: int, **booked: int) -> int:
        """Use up a chunk's number; book the missing steps before it, and `booked` for the chunk itself.

        Returns:
            The lost steps before it.
        """
        ledger = self._ledger(sender)
        missing = max(0, produced - steps - ledger.produced)
        rejected = missing if ledger.pending_rejected and sender.sequence == ledger.expected else 0
        booked["lost"] = booked.get("lost", 0) + missing - rejected
        booked["claimed"] = missing - rejected
        booked["rejected"] = booked.get("rejected", 0) + rejected
        booked["delivered"] = steps
        self.workers[sender.name] = replace(
            ledger,
            expected=sender.sequence + 1,
            flown=max(ledger.flown, flown, produced),
            produced=max(ledger.produced, produced),
            pending_rejected=False,
            pending_gap=False,
            **{name: getattr(ledger, name) + count for name, count in booked.items()},
        )
        return missing - rejected

    def now(self) -> LedgerSnapshot:
        """Return the present accounts."""
        with self._switch:
            return LedgerSnapshot(self.closed, dict(self.workers))

    def _ledger(self, sender: Envelope) -> WorkerLedger:
        ledger = self.workers.get(sender.name)
        if ledger is not None and sender.incarnation <= ledger.incarnation:
            return ledger
        fresh = WorkerLedger(sender.incarnation)
        with self._switch:  # a concurrent sum must find the old start in exactly one place
            if ledger is not None:
                ended = replace(ledger.given_up(), earlier=None)
                self.closed = _add(self.closed, ended)
                fresh = replace(fresh, earlier=_add(ledger.earlier or WorkerLedger(0), ended))
            self.workers[sender.name] = fresh
        return fresh


def _trouble_first(row: tuple[str, dict[str, int]]) -> tuple[int, int, str]:
    name, sums = row
    return -(sums["lost"] + sums["rejected"]), -sums["produced"], name


def _summed(parts: list[WorkerLedger]) -> dict[str, int]:
    """Return the reported sums of some accounts."""
    sums = {name: sum(getattr(part, name) for part in parts) for name in _REPORTED}
    return {"produced": sum(part.flown for part in parts), **sums}


def _rebuilt(entry: dict[str, Any]) -> WorkerLedger:
    earlier = entry["earlier"]
    return replace(_account({**entry, "earlier": None}), earlier=None if earlier is None else _account(earlier))


def _account(entry: dict[str, Any]) -> WorkerLedger:
    """Return one account; raise ValueError when a field is not a count."""
    if entry.keys() != {field.name for field in fields(WorkerLedger)}:
        raise ValueError("a field is missing")
    account = WorkerLedger(**entry)
    for field in fields(WorkerLedger):
        value = getattr(account, field.name)
        fits = type(value) is field.type and value >= 0 if field.name != "earlier" else value is None
        if not fits or (field.name in ("incarnation", "expected") and value >= 2**63 - 1):
            raise ValueError(f"{field.name} is not a count")
    return account


def _add(total: WorkerLedger, part: WorkerLedger) -> WorkerLedger:
    return replace(
        total,
        flown=total.flown + part.flown,
        produced=total.produced + part.produced,
        accepted=total.accepted + part.accepted,
        lost=total.lost + part.lost,
        claimed=total.claimed + part.claimed,
        rejected=total.rejected + part.rejected,
        duplicates=total.duplicates + part.duplicates,
        refused=total.refused + part.refused,
        aged=total.aged + part.aged,
        damaged=total.damaged + part.damaged,
    )
