"""Alarms about processes of a run: gone, silent, behind or slow."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

from eia_sec.deploy.monitor.snapshot import ProcessRow

BEHIND_VERSIONS: Final = 20
"""Parameter versions that a worker's actors may lag behind the learner before an alarm."""
SLOW_SHARE: Final = 0.25
"""A worker below this share of the median worker's rate raises an alarm."""
SETTLED_SECONDS: Final = 20.0
"""Uptime before which a worker's rate is ignored."""
WAITING_SHARE: Final = 0.5
"""A worker that waits for the learner for more than this share of the time is held back, and not in trouble itself."""
NAMED: Final = 3
"""Processes that an alarm names; the rest are counted."""


def examine(rows: Sequence[ProcessRow], training: bool, over: bool = False) -> tuple[tuple[ProcessRow, ...], list[str]]:
    """Return the rows with those in trouble and those that left marked, and one alarm for each kind of trouble.

    Args:
        rows: the processes.
        training: whether the workers should produce steps.
        over: whether the run is finished or draining, so that processes leave as intended.
    """
    rows = [replace(row, left=row.left or (over and not row.alive)) for row in rows]
    marked: set[tuple[str, str]] = set()
    sentences: list[str] = []

    def alarm(found: Sequence[ProcessRow], one: str, many: str) -> None:
        if found:
            marked.update((row.role, row.name) for row in found)
            sentences.append(f"{_names(found)} {one if len(found) == 1 else many}")

    alarm([row for row in rows if not (row.alive or row.left)], "is gone.", "are gone.")
    silent = [row for row in rows if row.alive and row.quiet]
    longest = max((row.age for row in silent), default=0.0)
    alarm(silent, f"has been silent for {longest:.0f} s.", f"have been silent for up to {longest:.0f} s.")
    workers = [row for row in rows if row.role == "rollout" and not (row.quiet or row.left)]
    late = [row for row in workers if (row.behind or 0) >= BEHIND_VERSIONS]
    oldest = max((row.behind or 0 for row in late), default=0)
    alarm(
        late, f"is behind: its actors are {oldest} versions old.", f"are behind: their actors are up to {oldest} old."
    )
    settled = [row for row in workers if row.rate is not None and row.uptime >= SETTLED_SECONDS]
    if training and settled:
        _alarm_of_slow(settled, alarm)
    return tuple(replace(row, trouble=(row.role, row.name) in marked) for row in rows), sentences


def _alarm_of_slow(settled: Sequence[ProcessRow], alarm: Callable[[Sequence[ProcessRow], str, str], None]) -> None:
    rates = sorted(row.rate or 0.0 for row in settled)
    middle = rates[len(rates) // 2]
    if middle == 0.0:
        stopped = [row for row in settled if not row.rate and (row.waits or 0.0) < WAITING_SHARE]
        alarm(stopped, "produces no steps.", "produce no steps.")
        return
    slow = [row for row in settled if (row.rate or 0.0) < SLOW_SHARE * middle]
    most = max((row.rate or 0.0 for row in slow), default=0.0)
    alarm(
        slow,
        f"produces {most:.0f} steps/s, the median worker {middle:.0f}.",
        f"produce at most {most:.0f} steps/s, the median worker {middle:.0f}.",
    )


def _names(rows: Sequence[ProcessRow]) -> str:
    """Return "rollout a, rollout b and 7 others"."""
    named = [f"{row.role} {row.name}" for row in rows[:NAMED]]
    rest = len(rows) - len(named)
    if rest:
        return f"{', '.join(named)} and {rest} other{'s' if rest > 1 else ''}"
    return named[0] if len(named) == 1 else f"{', '.join(named[:-1])} and {named[-1]}"
