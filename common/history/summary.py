"""Replaces old lines of a learner's history with totals, so that it stays small and keeps every loss.

Once chunks are in every kept checkpoint, no resume needs their lines. One line of totals for each start of a worker
replaces them.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Final

from eia_sec.common.history.history import SUMMED, Entry, Record, Resume, Start, Summary, Unreadable

MOST_STARTS: Final = 64
"""Most starts of a worker that have a line each; older starts share one line."""
Marks = Mapping[str, tuple[int, int]]
"""For each worker the incarnation and the next sequence number in a checkpoint."""


def summarised(records: Iterable[Record], marks: Marks) -> list[Record]:
    """Return a learner's records with the chunks before the marks replaced by totals.

    Starts come first, and ends are left out.

    Args:
        records: the history; no start of the learner can resume from before the marks.
        marks: each worker's position in the oldest kept checkpoint.
    """
    totals = _Totals()
    head: list[Record] = []
    rest: list[Record] = []
    for record in records:
        match record:
            case Entry() if record.worker in marks:
                for part, before in _split(record, marks[record.worker]):
                    (totals.add if before else rest.append)(part)
            case Entry():
                rest.append(record)
            case Summary():
                totals.merge(record)
            case Resume():
                totals.roll_back(record)
            case Start() | Unreadable():
                head.append(record)
    return [*head, *totals.summaries(), *rest]


def _split(entry: Entry, mark: tuple[int, int]) -> list[tuple[Entry, bool]]:
    """Split an entry at a mark; return its parts, and for each whether it lies before the mark."""
    start, expected = mark
    if (entry.incarnation, entry.last) < mark:
        return [(entry, True)]
    if entry.incarnation != start or entry.first >= expected or entry.verdict in SUMMED:
        return [(entry, False)]
    behind = (entry.last - expected + 1) * entry.steps
    produced, flown = max(0, entry.produced - behind), max(0, entry.flown - behind)
    return [
        (replace(entry, last=expected - 1, produced=produced, flown=flown), True),
        (replace(entry, first=expected), False),
    ]


class _Totals:
    def __init__(self) -> None:
        self._sums: dict[str, dict[int, Summary]] = defaultdict(dict)
        self._accepted: list[Entry] = []

    def merge(self, part: Summary) -> None:
        """Add earlier totals."""
        held = self._sums[part.worker].get(part.incarnation)
        self._sums[part.worker][part.incarnation] = part if held is None else held.plus(part)

    def add(self, entry: Entry) -> None:
        """Add an entry; `roll_back` can still undo accepted chunks."""
        whole = Summary(entry.worker, entry.incarnation, 0 if entry.verdict in SUMMED else entry.last)
        chunks, steps = len(entry.numbers), len(entry.numbers) * entry.steps
        match entry.verdict:
            case "accepted":
                self._accepted.append(entry)
                self.merge(replace(whole, accepted=chunks, accepted_steps=steps))
            case "refused":
                self.merge(replace(whole, refused=chunks, refused_steps=steps))
            case "missing":
                self.merge(replace(whole, missing_steps=entry.steps))
            case "undelivered":
                # A learner that was killed after this line meets the newer start again, and repeats it.
                held = self._sums[entry.worker].get(entry.incarnation, whole)
                self.merge(replace(whole, undelivered_steps=entry.steps - held.undelivered_steps))
            case "duplicate":
                self.merge(replace(whole, duplicates=entry.steps))

    def roll_back(self, resume: Resume) -> None:
        """Count accepted chunks that a checkpoint does not hold as lost; a later resume may be from an older one."""
        for worker, by_start in self._sums.items():
            for start, total in by_start.items():
                if start >= resume.workers.get(worker, (0, 0))[0]:  # the learner writes it again, if it comes to that
                    by_start[start] = replace(total, undelivered_steps=0)
        accepted, self._accepted = self._accepted, []
        for entry in accepted:
            for part, held in _split(entry, resume.workers.get(entry.worker, (0, 0))):
                if held:
                    self._accepted.append(part)
                else:
                    chunks, steps = len(part.numbers), len(part.numbers) * part.steps
                    whole = Summary(part.worker, part.incarnation, part.last)
                    self.merge(replace(whole, accepted=-chunks, accepted_steps=-steps, lost=chunks, lost_steps=steps))

    def summaries(self) -> list[Summary]:
        """Return one summary for each of a worker's newest starts, and one for those before."""
        found: list[Summary] = []
        for by_start in self._sums.values():
            parts = [by_start[start] for start in sorted(by_start)]
            while len(parts) > MOST_STARTS:
                oldest, second = parts[:2]
                parts[:2] = [replace(oldest.plus(second), incarnation=second.incarnation, last=second.last)]
            found += parts
        return found
