"""The offline audit of a run: the processes' histories compared with one another, chunk by chunk.

Every chunk has an id: worker, incarnation, sequence number. Each one that was produced must be accepted once, rejected,
declared lost or still in flight, and the answer that its worker got must be the learner's verdict. The audit names
whatever else it finds, and every line that was damaged after it was written.
"""

import json
import sys
from bisect import bisect_right
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from eia_sec.common.errors import RunDirError
from eia_sec.common.history.history import End, Entry, Record, Resume, Start, Summary, Unreadable, read
from eia_sec.deploy.local.file_ends import last_lines
from eia_sec.deploy.local.run_directory import HISTORY, METRICS, no_run
from eia_sec.deploy.monitor.chunk_ranges import ChunkRanges, shared_ranges

LAST_BYTES: Final = 2**20
"""Most bytes of a learner's last records that are looked at."""
MOST_LINES: Final = 2**24
"""Most lines of all histories; an audit holds each of them in memory, however many chunks it is about."""
NAMED: Final = 20
"""Findings that the command prints; it counts the rest, and --json prints all."""
FATES: Final = ("accepted", "lost", "rejected", "in_flight")
_ANSWERS: Final = {
    "acknowledged": ("accepted", ("accepted", "rolled back")),
    "refused": ("refused", ("refused",)),
    # An answer was lost on its way, and the chunk came again.
    "repeated": ("a duplicate", ("accepted", "rolled back", "refused")),
}
"""For each answer in a worker's history its wording, and the learner's verdicts that it may stand for."""

Source = tuple[str, int]
"""A worker's name and incarnation."""


@dataclass
class Audit:
    """The result of an audit.

    Attributes:
        chunks: for each fate, chunks.
        steps: for each fate, environment steps.
        lost_with: steps that were lost with the learner (acknowledged, not yet in a checkpoint), with a worker
            (produced, never delivered), or whose loss only the learner knows of.
        workers: for each worker, steps by fate.
        duplicates: chunks that arrived again and were not counted again.
        starts: starts of the learner.
        unexplained: one sentence for each range of ids, number or line without explanation.
        doubled: one sentence for each range of ids that was accepted twice.
        damaged: unreadable lines of histories, each of them named.
        torn: incomplete last lines, left when a process was killed or its disk was full; not a defect.
        summed: chunks for which the learner's history holds only totals.
        held: lines of all histories held in memory.
    """

    chunks: Counter[str] = field(default_factory=Counter)
    steps: Counter[str] = field(default_factory=Counter)
    lost_with: Counter[str] = field(default_factory=Counter)
    workers: dict[str, Counter[str]] = field(default_factory=dict)
    duplicates: int = 0
    starts: int = 0
    unexplained: list[str] = field(default_factory=list)
    doubled: list[str] = field(default_factory=list)
    damaged: int = 0
    torn: int = 0
    summed: int = 0
    held: int = 0

    @property
    def produced(self) -> int:
        """Return the environment steps that were produced."""
        return sum(self.steps[fate] for fate in FATES)

    @property
    def clean(self) -> bool:
        """Return whether everything is explained and nothing was counted twice."""
        return not self.unexplained and not self.doubled

    def named(self) -> list[str]:
        """Return one sentence for each unexplained or doubled item."""
        return [*self.unexplained, *self.doubled]

    def book(self, worker: str, fate: str, steps: int, chunks: int = 1) -> None:
        """Count chunks, one unless said otherwise, with so many steps together."""
        self.chunks[fate] += chunks
        self.steps[fate] += steps
        self.workers.setdefault(worker, Counter())[fate] += steps

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain values, with all sentences."""
        return {
            "clean": self.clean,
            "produced": self.produced,
            "steps": {fate: self.steps[fate] for fate in FATES},
            "chunks": {fate: self.chunks[fate] for fate in FATES},
            "lost_with": dict(self.lost_with),
            "workers": {name: {fate: counts[fate] for fate in FATES} for name, counts in sorted(self.workers.items())},
            "duplicates": self.duplicates,
            "learner_starts": self.starts,
            "unexplained": len(self.unexplained),
            "doubled": len(self.doubled),
            "damaged_lines": self.damaged,
            "torn_lines": self.torn,
            "summed_chunks": self.summed,
            "named": self.named(),
        }


@dataclass
class _Sent:
    """One start of a worker by its own history: steps and answers by number, and whether it has ended."""

    steps: ChunkRanges[int] = field(default_factory=ChunkRanges)
    answers: ChunkRanges[str] = field(default_factory=ChunkRanges)
    over: bool = False


@dataclass
class _Received:
    """One start of a worker by the learner's history: fate and steps by number.

    The history may begin later than the run, with the checkpoint of a resume: `first` is the first number that this one
    did not hold. Chunks up to number `summed` are known by their `summary` alone. `undelivered` steps were flown beyond
    the last chunk when a newer start came.
    """

    fate: ChunkRanges[tuple[str, int]] = field(default_factory=ChunkRanges)
    first: int = 1
    missing: int = 0
    missing_before: set[int] = field(default_factory=set)
    undelivered: int = 0
    summary: Summary | None = None
    summed: int = 0
    _ordered: list[int] = field(default_factory=list)

    def declared_missing(self, number: int) -> bool:
        """Return whether the next number that the learner knows came with the word that those before are missing."""
        ordered = self._ordered_missing()
        at, known = bisect_right(ordered, number), self.fate.next_after(number)
        return at < len(ordered) and (known is None or ordered[at] <= known)

    def _ordered_missing(self) -> list[int]:
        if len(self._ordered) != len(self.missing_before):
            self._ordered = sorted(self.missing_before)
        return self._ordered


def audit(run_dir: Path) -> Audit:
    """Audit a run directory.

    Raises:
        RunDirError: when it holds no history of a learner, one that names neither a start nor a chunk, one that
            cannot be read, or more lines than MOST_LINES.
    """
    folder = run_dir / HISTORY
    if not (folder / "learner.jsonl").is_file():
        raise RunDirError(no_run(run_dir, f"{HISTORY}/learner.jsonl"))
    found = Audit()
    received = _learner(_records(folder / "learner.jsonl", found), found)
    if not (found.starts or received or found.damaged):  # a start that is damaged is named instead
        raise RunDirError(f"{folder / 'learner.jsonl'} holds no start of a learner; there is nothing to audit.")
    sent: dict[Source, _Sent] = {}
    for path in sorted(folder.glob("*.jsonl")):
        if path.name != "learner.jsonl":
            _worker(_records(path, found), sent)
    newest: dict[str, int] = {}
    for worker, incarnation in [*sent, *received]:
        newest[worker] = max(newest.get(worker, 0), incarnation)
    for source in sorted({*sent, *received}):
        part = received[source] if source in received else _unnamed(source, received, sent[source])
        _compare(source, sent.get(source), part, source[1] < newest[source[0]], found)
    _compare_with_ledger(run_dir / METRICS, found, whole=all(part.first == 1 for part in received.values()))
    return found


def _unnamed(source: Source, received: dict[Source, _Received], sent: _Sent) -> _Received:
    """Return what the learner's history holds of a start that it does not name: nothing, or more than single lines."""
    worker, start = source
    later = [part for (w, s), part in received.items() if w == worker and s > start]
    if any(part.summary is not None for part in later):
        return _Received(summed=sent.answers.last)
    return _Received(first=sys.maxsize if any(part.first > 1 for part in later) else 1)


def _records(path: Path, found: Audit) -> list[Record]:
    try:
        records, torn = read(path)
    except (OSError, ValueError) as error:
        raise RunDirError(f"{path} cannot be read: {error}.") from error
    found.torn += torn
    found.held += len(records)
    if found.held > MOST_LINES:
        raise RunDirError(f"with {path} the histories hold {found.held:,} lines, more than {MOST_LINES:,}.")
    for record in records:
        if isinstance(record, Unreadable):
            found.damaged += 1
            found.unexplained.append(f"line {record.number} of {path.name} is unreadable, and not a torn last line.")
    return records


def _learner(records: list[Record], found: Audit) -> dict[Source, _Received]:
    received: dict[Source, _Received] = {}
    for record in records:
        match record:
            case Start():
                found.starts += 1
            case Resume():
                _roll_back(received, record)
            case Summary():
                part = received.setdefault((record.worker, record.incarnation), _Received())
                part.summary, part.summed = record, record.last
                _book_summary(record, found)
            case Entry(verdict="duplicate"):
                found.duplicates += record.steps
            case Entry(verdict="missing"):
                part = received.setdefault((record.worker, record.incarnation), _Received())
                part.missing += record.steps
                part.missing_before.add(record.first)
            case Entry(verdict="undelivered"):
                received.setdefault((record.worker, record.incarnation), _Received()).undelivered = record.steps
            case Entry():
                source = record.worker, record.incarnation
                _take(received.setdefault(source, _Received()), source, record, found)
    return received


def _book_summary(summary: Summary, found: Audit) -> None:
    """Count the chunks of which only totals are left."""
    found.duplicates += summary.duplicates
    found.summed += summary.accepted + summary.refused + summary.lost
    fates = (
        ("accepted", summary.accepted, summary.accepted_steps),
        ("rejected", summary.refused, summary.refused_steps),
        ("lost", summary.lost, summary.lost_steps + summary.missing_steps),
    )
    for fate, chunks, steps in fates:
        found.book(summary.worker, fate, steps, chunks)
    found.lost_with["learner"] += summary.lost_steps
    found.lost_with["unknown"] += summary.missing_steps


def _take(part: _Received, source: Source, record: Entry, found: Audit) -> None:
    for first, last, (fate, _) in part.fate.within(record.first, record.last):
        if fate == "accepted":
            found.doubled.append(f"{_name(source, first, last)} {record.verdict} after it had been accepted.")
    part.fate.put(record.first, record.last, (record.verdict, record.steps))


def _roll_back(received: dict[Source, _Received], resume: Resume) -> None:
    for worker, (incarnation, expected) in resume.workers.items():
        part = received.setdefault((worker, incarnation), _Received())
        if not part.fate:
            part.first = expected
    for (worker, incarnation), part in received.items():
        held = resume.workers.get(worker, (0, 0))
        if incarnation >= held[0]:
            part.undelivered = 0  # the resumed learner does not know of the newer start yet
            kept = held[1] - 1 if incarnation == held[0] else 0
            for first, last, (fate, steps) in part.fate.within(kept + 1, part.fate.last):
                if fate == "accepted":
                    part.fate.put(first, last, ("rolled back", steps))


def _worker(records: list[Record], sent: dict[Source, _Sent]) -> None:
    now: _Sent | None = None
    for record in records:
        match record:
            case Start():
                if now is not None:
                    now.over = True
                now = sent.setdefault((record.name, record.incarnation), _Sent())
            case End() if now is not None:
                now.over = True
            case Entry():
                part = sent.setdefault((record.worker, record.incarnation), _Sent())
                if record.verdict == "produced":
                    part.steps.put(record.first, record.last, record.steps)
                elif record.verdict in _ANSWERS:
                    part.answers.put(record.first, record.last, record.verdict)


def _compare(source: Source, sent: _Sent | None, received: _Received, replaced: bool, found: Audit) -> None:
    if sent is None:
        _without_worker(source, received, found)
        return
    cuts = (received.first, received.summed + 1, *received.missing_before)
    ranges = list(shared_ranges(sent.steps, sent.answers, received.fate, cuts=cuts))
    for first, last in ranges:
        if first > received.summed:
            _compare_verdicts(source, sent, received, first, last, found)
    for first, last in ranges:
        if first > received.summed and sent.steps.get(first) is not None:
            _book_produced(source, sent, received, first, last, sent.over or replaced, found)
    for first, last in ranges:
        fate = received.fate.get(first)
        if fate is not None and sent.steps.get(first) is None:
            found.unexplained.append(f"{_name(source, first, last)} {fate[0]}, and never produced by its worker.")


def _book_produced(
    source: Source, sent: _Sent, received: _Received, first: int, last: int, over: bool, found: Audit
) -> None:
    """Book chunks that a worker produced and that share one fate."""
    each, chunks = sent.steps.get(first) or 0, last - first + 1
    steps, answer = each * chunks, sent.answers.get(first)
    fate, counted = received.fate.get(first) or ("", 0)
    if fate in ("accepted", "rolled back") and counted != each:
        found.unexplained.append(
            f"{_name(source, first, last)} produced with {each} steps each, and counted with {counted}."
        )
    if fate == "accepted":
        found.book(source[0], "accepted", steps, chunks)
    elif fate == "refused":
        found.book(source[0], "rejected", steps, chunks)
    elif fate == "rolled back" or received.declared_missing(first):
        found.book(source[0], "lost", steps, chunks)
        found.lost_with["learner"] += steps
    elif answer is not None and first < received.first:
        found.book(source[0], "rejected" if answer == "refused" else "accepted", steps, chunks)
    elif answer is not None:
        name = _name(source, first, last)
        found.unexplained.append(f"{name} answered as {_ANSWERS[answer][0]}, and the learner knows nothing of it.")
    else:
        found.book(source[0], "lost" if over else "in_flight", steps, chunks)
        if over:
            found.lost_with["worker"] += steps


def _compare_verdicts(source: Source, sent: _Sent, received: _Received, first: int, last: int, found: Audit) -> None:
    answer = sent.answers.get(first)
    if answer is None:
        return
    said, meant = _ANSWERS[answer]
    fate = (received.fate.get(first) or ("", 0))[0]
    if fate and fate not in meant:
        found.unexplained.append(f"{_name(source, first, last)} {fate}, and its worker was answered that it is {said}.")
    elif not fate and sent.steps.get(first) is None:
        found.unexplained.append(f"{_name(source, first, last)} answered as {said}, and never produced by its worker.")


def _without_worker(source: Source, received: _Received, found: Audit) -> None:
    """Book a worker of which there is no history of its own; numbers that the learner never saw must be missed."""
    expected = max(received.first, received.summed + 1)
    for first, last, (fate, each) in received.fate:
        if first > expected and first not in received.missing_before:
            found.unexplained.append(
                f"chunk {source[0]}/{source[1]}/{expected} to {first - 1} never arrived; no history says why."
            )
        expected = last + 1
        kind = {"accepted": "accepted", "refused": "rejected"}.get(fate, "lost")
        steps = each * (last - first + 1)
        found.book(source[0], kind, steps, last - first + 1)
        if kind == "lost":
            found.lost_with["learner"] += steps
    summed = 0 if received.summary is None else received.summary.undelivered_steps
    if unknown := received.missing + received.undelivered + summed:
        found.steps["lost"] += unknown
        found.workers.setdefault(source[0], Counter())["lost"] += unknown
        found.lost_with["unknown"] += unknown


def _compare_with_ledger(metrics: Path, found: Audit, *, whole: bool) -> None:
    """Compare the learner's last ledger with the histories, if its last start ended as intended.

    Args:
        metrics: the learner's records.
        found: the result of the histories.
        whole: whether they go back to the run's beginning; if not, the ledger's sums cover more.
    """
    try:
        last = [json.loads(line) for line in last_lines(metrics, LAST_BYTES)[-2:]]
    except (OSError, ValueError, RecursionError):
        return
    if [record.get("kind") for record in last if isinstance(record, dict)] != ["status", "end"]:
        return
    ledger = last[0].get("ledger", {})
    if not (isinstance(ledger, dict) and type(ledger.get("lost", 0)) is int):
        found.unexplained.append(f"{metrics.name}: the ledger in its last status is none.")
        return
    claims = {"accepted": ledger.get("accepted"), "steps in replay": last[0].get("environment_steps")}
    for name, value in claims.items():
        if whole and value != found.steps["accepted"]:
            found.unexplained.append(f"{name}: the learner says {value}, the histories {found.steps['accepted']}.")
    if ledger.get("unexplained"):
        found.unexplained.append(f"the learner itself could not explain {ledger['unexplained']} steps.")
    if whole and ledger.get("lost", 0) > found.steps["lost"]:
        found.unexplained.append(f"lost: the learner says {ledger['lost']}, the histories {found.steps['lost']}.")


def _name(source: Source, first: int, last: int) -> str:
    """Return the beginning of a sentence about some chunks."""
    worker, start = source
    return f"chunk {worker}/{start}/{first} was" if first == last else f"chunks {worker}/{start}/{first} to {last} were"
