"""Which processes of a fleet somebody should look at, and the sentences that say so."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

from deploy.monitor.snapshot import ProcessRow

BEHIND_VERSIONS: Final = 20
"""Parameter versions by which a worker's actors may be older than the learner's newest before it is named."""
SLOW_SHARE: Final = 0.25
"""A worker that makes less than this share of what the middle worker makes is named."""
SETTLED_SECONDS: Final = 20.0
"""Uptime before which a worker's rate says nothing."""
NAMED: Final = 3
"""Processes that one sentence names; the others are counted."""

Sentence = Callable[[Sequence[ProcessRow], str], str]


def examine(rows: Sequence[ProcessRow], training: bool, over: bool = False) -> tuple[tuple[ProcessRow, ...], list[str]]:
    """Return the rows with those in trouble marked, and one sentence for each kind of trouble.

    Args:
        rows: the fleet.
        training: whether the workers are supposed to fly.
        over: whether the run's episodes are done or it drains, so that processes leave as they should.
    """
    marked: set[tuple[str, str]] = set()
    sentences: list[str] = []

    def complain(found: Sequence[ProcessRow], one: str, many: str) -> None:
        if found:
            marked.update((row.role, row.name) for row in found)
            sentences.append(f"{_names(found)} {one if len(found) == 1 else many}")

    complain([row for row in rows if not (over or row.alive or row.left)], "is gone.", "are gone.")
    silent = [row for row in rows if row.alive and row.quiet]
    longest = max((row.age for row in silent), default=0.0)
    complain(silent, f"has said nothing for {longest:.0f} s.", f"have said nothing for up to {longest:.0f} s.")
    workers = [row for row in rows if row.role == "rollout" and not (row.quiet or row.left)]
    late = [row for row in workers if (row.behind or 0) >= BEHIND_VERSIONS]
    oldest = max((row.behind or 0 for row in late), default=0)
    complain(
        late, f"is behind: its actors are {oldest} versions old.", f"are behind: their actors are up to {oldest} old."
    )
    settled = [row for row in workers if row.rate is not None and row.uptime >= SETTLED_SECONDS]
    if training and settled:
        _complain_of_slow(settled, complain)
    return tuple(replace(row, trouble=(row.role, row.name) in marked) for row in rows), sentences


def _complain_of_slow(
    settled: Sequence[ProcessRow], complain: Callable[[Sequence[ProcessRow], str, str], None]
) -> None:
    rates = sorted(row.rate or 0.0 for row in settled)
    middle = rates[len(rates) // 2]
    if middle == 0.0:
        stopped = [row for row in settled if not row.rate]
        complain(stopped, "has stopped flying.", "have stopped flying.")
        return
    slow = [row for row in settled if (row.rate or 0.0) < SLOW_SHARE * middle]
    most = max((row.rate or 0.0 for row in slow), default=0.0)
    complain(
        slow,
        f"makes {most:.0f} steps/s, the middle worker {middle:.0f}.",
        f"make at most {most:.0f} steps/s, the middle worker {middle:.0f}.",
    )


def _names(rows: Sequence[ProcessRow]) -> str:
    """Return "rollout a, rollout b and 7 others"."""
    named = [f"{row.role} {row.name}" for row in rows[:NAMED]]
    rest = len(rows) - len(named)
    if rest:
        return f"{', '.join(named)} and {rest} other{'s' if rest > 1 else ''}"
    return named[0] if len(named) == 1 else f"{', '.join(named[:-1])} and {named[-1]}"
