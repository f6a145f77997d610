"""The offline audit of a run: the processes' histories held against one another, chunk by chunk.

Every chunk has an id: worker, incarnation, sequence number. Each one that was made must be accepted once, or rejected,
or declared lost, or still be in flight, and its worker must have been told what the learner wrote down; whatever else
is found is named, and so is every line that was damaged after it was written.
"""

import json
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from common.errors import RunDirError
from common.history import End, Entry, Record, Resume, Start, Summary, Unreadable, read
from deploy.local.run_directory import HISTORY, METRICS

MOST_CHUNKS: Final = 2**26
"""Most chunks that histories may tell of; an audit holds each of them in memory."""
NAMED: Final = 20
"""Sentences that the command prints one by one; it counts the rest, and as JSON it prints all."""
FATES: Final = ("accepted", "lost", "rejected", "in_flight")
_TOLD: Final = {
    "acknowledged": ("accepted", ("accepted", "rolled back")),
    "refused": ("refused", ("refused",)),
    # An answer was lost on its way, and the chunk came again.
    "repeated": ("a duplicate", ("accepted", "rolled back", "refused")),
}
"""For each verdict in a worker's history how it is said, and the learner's verdicts that it may stand for."""

Source = tuple[str, int]
"""A worker's name and incarnation."""


@dataclass
class Audit:
    """What an audit found.

    Attributes:
        chunks: for each fate, chunks.
        steps: for each fate, environment steps.
        lost_with: steps that were lost with the learner (acknowledged, not yet in a checkpoint), with a worker (made,
            never delivered), or whose loss only the learner knows of.
        workers: for each worker, steps by fate.
        duplicates: chunks that came again and were not counted again.
        starts: starts of the learner.
        unexplained: one sentence for each id (or range of ids), figure or line without explanation.
        doubled: one sentence for each id that was accepted twice.
        damaged: lines of histories that cannot be read, each of them named.
        torn: last lines that were torn off when their process was killed or its disk was full, which is no defect.
        summed: chunks of which the learner's history holds totals alone.
        held: chunks that are held in memory, those of all histories together.
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
        """Return the environment steps that were made."""
        return sum(self.steps[fate] for fate in FATES)

    @property
    def clean(self) -> bool:
        """Return whether everything is explained and nothing was counted twice."""
        return not self.unexplained and not self.doubled

    def named(self) -> list[str]:
        """Return a sentence for whatever is unexplained or doubled."""
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
class _Made:
    """One start of a worker as its own history tells it: steps and verdicts by number, and whether it has ended."""

    steps: dict[int, int] = field(default_factory=dict)
    told: dict[int, str] = field(default_factory=dict)
    over: bool = False


@dataclass
class _Taken:
    """One start of a worker as the learner's history tells it: fate and steps by number.

    The history may begin later than the run, with a checkpoint that was taken up: `first` is the first number that this
    one did not know. Chunks up to number `summed` are known by their `summary` alone.
    """

    fate: dict[int, tuple[str, int]] = field(default_factory=dict)
    first: int = 1
    missing: int = 0
    missing_before: set[int] = field(default_factory=set)
    summary: Summary | None = None
    summed: int = 0

    def declared_missing(self, number: int) -> bool:
        """Return whether the next number that the learner knows came with the word that those before are missing."""
        later = [known for known in self.missing_before if known > number]
        return bool(later) and not any(number < known < min(later) for known in self.fate)


def audit(run_dir: Path) -> Audit:
    """Audit a run directory.

    Raises:
        RunDirError: when it holds no history of a learner, one that cannot be read, or more chunks than MOST_CHUNKS.
    """
    folder = run_dir / HISTORY
    if not (folder / "learner.jsonl").is_file():
        raise RunDirError(f"{run_dir} holds no {HISTORY}/learner.jsonl; is it a run directory?")
    found = Audit()
    taken = _learner(_records(folder / "learner.jsonl", found), found)
    made: dict[Source, _Made] = {}
    for path in sorted(folder.glob("*.jsonl")):
        if path.name != "learner.jsonl":
            _worker(_records(path, found), made)
    newest: dict[str, int] = {}
    for worker, incarnation in [*made, *taken]:
        newest[worker] = max(newest.get(worker, 0), incarnation)
    for source in sorted({*made, *taken}):
        part = taken[source] if source in taken else _unheard(source, taken, made[source])
        _compare(source, made.get(source), part, source[1] < newest[source[0]], found)
    _hold_against_ledger(run_dir / METRICS, found, whole=all(part.first == 1 for part in taken.values()))
    return found


def _unheard(source: Source, taken: dict[Source, _Taken], made: _Made) -> _Taken:
    """Return what the learner's history holds of a start that it does not name: nothing, or more than single lines."""
    worker, start = source
    later = [part for (w, s), part in taken.items() if w == worker and s > start]
    if any(part.summary is not None for part in later):
        return _Taken(summed=max(made.told, default=0))
    return _Taken(first=sys.maxsize if any(part.first > 1 for part in later) else 1)


def _records(path: Path, found: Audit) -> list[Record]:
    try:
        records, torn = read(path)
    except (OSError, ValueError) as error:
        raise RunDirError(f"{path} cannot be read: {error}.") from error
    found.torn += torn
    found.held += sum(len(part.numbers) for part in records if isinstance(part, Entry))
    if found.held > MOST_CHUNKS:
        raise RunDirError(f"with {path} the histories tell of {found.held:,} chunks, more than {MOST_CHUNKS:,}.")
    for number, record in enumerate(records, start=1):
        if isinstance(record, Unreadable):
            found.damaged += 1
            found.unexplained.append(f"line {number} of {path.name} cannot be read, and is not torn off.")
    return records


def _numbers(entry: Entry) -> Iterator[tuple[Source, int]]:
    for number in entry.numbers:
        yield (entry.worker, entry.incarnation), number


def _learner(records: list[Record], found: Audit) -> dict[Source, _Taken]:
    taken: dict[Source, _Taken] = {}
    for record in records:
        match record:
            case Start():
                found.starts += 1
            case Resume():
                _roll_back(taken, record)
            case Summary():
                part = taken.setdefault((record.worker, record.incarnation), _Taken())
                part.summary, part.summed = record, record.last
                _book_summary(record, found)
            case Entry(verdict="duplicate"):
                found.duplicates += record.steps
            case Entry(verdict="missing"):
                part = taken.setdefault((record.worker, record.incarnation), _Taken())
                part.missing += record.steps
                part.missing_before.add(record.first)
            case Entry():
                for source, number in _numbers(record):
                    _take(taken.setdefault(source, _Taken()), source, number, record, found)
    return taken


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


def _take(part: _Taken, source: Source, number: int, record: Entry, found: Audit) -> None:
    before = part.fate.get(number)
    if before is not None and before[0] == "accepted":
        found.doubled.append(f"{_name(source, number)} was {record.verdict} after it had been accepted.")
    part.fate[number] = (record.verdict, record.steps)


def _roll_back(taken: dict[Source, _Taken], resume: Resume) -> None:
    for worker, (incarnation, expected) in resume.workers.items():
        part = taken.setdefault((worker, incarnation), _Taken())
        if not part.fate:
            part.first = expected
    for (worker, incarnation), part in taken.items():
        held = resume.workers.get(worker, (0, 0))
        for number, (fate, steps) in part.fate.items():
            if fate == "accepted" and (incarnation, number) >= held:
                part.fate[number] = ("rolled back", steps)


def _worker(records: list[Record], made: dict[Source, _Made]) -> None:
    now: _Made | None = None
    for record in records:
        match record:
            case Start():
                if now is not None:
                    now.over = True
                now = made.setdefault((record.name, record.incarnation), _Made())
            case End() if now is not None:
                now.over = True
            case Entry():
                for source, number in _numbers(record):
                    part = made.setdefault(source, _Made())
                    if record.verdict == "produced":
                        part.steps[number] = record.steps
                    elif record.verdict in _TOLD:
                        part.told[number] = record.verdict


def _compare(source: Source, made: _Made | None, taken: _Taken, replaced: bool, found: Audit) -> None:
    if made is None:
        _without_worker(source, taken, found)
        return
    over = made.over or replaced
    _compare_verdicts(source, made, taken, found)
    single = {number: steps for number, steps in made.steps.items() if number > taken.summed}
    for number, steps in single.items():
        fate, counted = taken.fate.get(number, ("", 0))
        if fate in ("accepted", "rolled back") and counted != steps:
            found.unexplained.append(f"{_name(source, number)} has {steps} steps, and {counted} were counted.")
        if fate == "accepted":
            found.book(source[0], "accepted", steps)
        elif fate == "rolled back":
            found.book(source[0], "lost", steps)
            found.lost_with["learner"] += steps
        elif fate == "refused":
            found.book(source[0], "rejected", steps)
        elif taken.declared_missing(number):
            found.book(source[0], "lost", steps)
            found.lost_with["learner"] += steps
        elif number in made.told and number < taken.first:
            found.book(source[0], "rejected" if made.told[number] == "refused" else "accepted", steps)
        elif number in made.told:
            said = _TOLD[made.told[number]][0]
            found.unexplained.append(f"{_name(source, number)} was told to be {said}, and the learner knows nothing.")
        else:
            found.book(source[0], "lost" if over else "in_flight", steps)
            if over:
                found.lost_with["worker"] += steps
    for number in sorted(set(taken.fate) - set(made.steps)):
        found.unexplained.append(f"{_name(source, number)} was {taken.fate[number][0]}, and its worker never made it.")


def _compare_verdicts(source: Source, made: _Made, taken: _Taken, found: Audit) -> None:
    for number, told in sorted(made.told.items()):
        if number <= taken.summed:
            continue
        said, meant = _TOLD[told]
        fate = taken.fate.get(number, ("", 0))[0]
        if fate and fate not in meant:
            found.unexplained.append(f"{_name(source, number)} was {fate}, and its worker was told that it is {said}.")
        elif not fate and number not in made.steps:
            found.unexplained.append(f"{_name(source, number)} was told to be {said}, and its worker never made it.")


def _without_worker(source: Source, taken: _Taken, found: Audit) -> None:
    """Book a worker of which there is no history of its own; numbers that the learner never saw must be missed."""
    expected = max(taken.first, taken.summed + 1)
    for number, (fate, steps) in sorted(taken.fate.items()):
        if number > expected and number not in taken.missing_before:
            found.unexplained.append(f"{_name(source, expected)} to {number - 1} never came, and nobody says why.")
        expected = number + 1
        kind = {"accepted": "accepted", "refused": "rejected"}.get(fate, "lost")
        found.book(source[0], kind, steps)
        if kind == "lost":
            found.lost_with["learner"] += steps
    if taken.missing:
        found.steps["lost"] += taken.missing
        found.workers.setdefault(source[0], Counter())["lost"] += taken.missing
        found.lost_with["unknown"] += taken.missing


def _hold_against_ledger(metrics: Path, found: Audit, *, whole: bool) -> None:
    """Hold the learner's last ledger against the histories, when its last start came to an orderly end.

    Args:
        metrics: the learner's records.
        found: what the histories tell.
        whole: whether they go back to the run's beginning; if not, the ledger's sums are of more than they tell.
    """
    try:
        lines = metrics.read_text(encoding="utf-8", errors="replace").splitlines()[-2:]
        last = [json.loads(line) for line in lines]
    except (OSError, ValueError):
        return
    if [record.get("kind") for record in last if isinstance(record, dict)] != ["status", "end"]:
        return
    ledger = last[0].get("ledger", {})
    told = {"accepted": ledger.get("accepted"), "steps in replay": last[0].get("environment_steps")}
    for name, value in told.items():
        if whole and value != found.steps["accepted"]:
            found.unexplained.append(f"{name}: the learner says {value}, the histories {found.steps['accepted']}.")
    if ledger.get("unexplained"):
        found.unexplained.append(f"the learner itself could not explain {ledger['unexplained']} steps.")
    if whole and ledger.get("lost", 0) > found.steps["lost"]:
        found.unexplained.append(f"lost: the learner says {ledger['lost']}, the histories {found.steps['lost']}.")


def _name(source: Source, number: int) -> str:
    return f"chunk {source[0]}/{source[1]}/{number}"
