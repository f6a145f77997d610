"""How the learner spends its time: training, and waiting for one thing or another."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

Phase = Literal["data", "imitation", "producers", "training", "checkpoint"]


class PhaseTimes:
    """Seconds in each phase since the start.

    `producers` is not a phase of the loop but the time during which collection is ahead of updates and workers wait; it
    overlaps the others.
    """

    def __init__(self) -> None:
        self._seconds: dict[str, float] = dict.fromkeys(
            ("data", "imitation", "producers", "training", "checkpoint"), 0.0
        )
        self._lap = time.monotonic()

    @contextmanager
    def measure(self, phase: Phase) -> Iterator[None]:
        """Add the time that the block takes to a phase."""
        started = time.monotonic()
        try:
            yield
        finally:
            self._seconds[phase] += time.monotonic() - started

    def lap(self, *, producers_wait: bool) -> None:
        """End an iteration of the loop; if workers had to wait, it counts as `producers`."""
        now = time.monotonic()
        if producers_wait:
            self._seconds["producers"] += now - self._lap
        self._lap = now

    def seconds(self) -> dict[str, float]:
        """Return the seconds of each phase."""
        return dict(self._seconds)
