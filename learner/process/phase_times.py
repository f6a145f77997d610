"""How the learner spends its time: training, writing checkpoints, or waiting."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

from eia_sec.common.clock import monotonic

Phase = Literal["data", "imitation", "producers", "training", "checkpoint"]


class PhaseTimes:
    """Seconds in each phase since the start.

    `producers` is not a phase of the loop. It is the time during which collection is ahead of updates and workers wait,
    and it overlaps the phases.
    """

    def __init__(self) -> None:
        self._seconds: dict[str, float] = dict.fromkeys(
            ("data", "imitation", "producers", "training", "checkpoint"), 0.0
        )
        self._lap = monotonic()

    @contextmanager
    def measure(self, phase: Phase) -> Iterator[None]:
        """Add the duration of the `with` block to a phase."""
        started = monotonic()
        try:
            yield
        finally:
            self._seconds[phase] += monotonic() - started

    def lap(self, *, producers_wait: bool) -> None:
        """End an iteration of the loop; if workers had to wait, it counts as `producers`."""
        now = monotonic()
        if producers_wait:
            self._seconds["producers"] += now - self._lap
        self._lap = now

    def seconds(self) -> dict[str, float]:
        """Return the seconds of each phase."""
        return dict(self._seconds)
