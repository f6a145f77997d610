"""What a command waits for and how far its work is, on standard error: live on a terminal, else a line now and then."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Final

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.status import Status
from rich.text import Text

PLAIN_SECONDS: Final = 10.0
"""Pause between two lines without a terminal; quick work prints none."""


@contextmanager
def progress(what: str) -> Iterator[Callable[[float], None]]:
    """Show how far some work has come.

    Args:
        what: the work, in words.

    Yields:
        What takes the share that is done, 0 to 1.
    """
    console = Console(stderr=True, highlight=False, markup=False)
    if not console.is_terminal:
        yield _Lines(what).tell
        return
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(what, total=1.0)
        yield lambda share: bar.update(task, completed=share)


def part(tell: Callable[[float], None], done: int, parts: int) -> Callable[[float], None]:
    """Return what takes the share of one of several equal parts, of which some are done."""
    return lambda share: tell((done + share) / parts)


QUIET_SECONDS: Final = 1.0
"""Wait of which nothing is said."""


class Countdown:
    """Says on standard error what a command waits for, and how many seconds are left.

    Args:
        what: what it waits for, in words.
        seconds: how long it waits at most.
        waiting: whether it still waits; False gives up.
    """

    def __init__(self, what: str, seconds: float, waiting: Callable[[], bool]) -> None:
        self._what, self._waiting = what, waiting
        self._began = time.monotonic()
        self._end = self._began + seconds
        self._console = Console(stderr=True, highlight=False, markup=False)
        self._status: Status | None = None
        self._printed = float("-inf")

    def __enter__(self) -> Callable[[], bool]:
        return self._tick

    def __exit__(self, *error: object) -> None:
        if self._status is not None:
            self._status.stop()

    def _tick(self) -> bool:
        now = time.monotonic()
        left = self._end - now
        if now - self._began >= QUIET_SECONDS and left >= QUIET_SECONDS / 2:
            said = f"waiting for {self._what}: {left:.0f} s left"
            if self._console.is_terminal:
                self._show(said)
            elif now - self._printed >= PLAIN_SECONDS:
                self._printed = now
                _write(said)
        return self._waiting()

    def _show(self, said: str) -> None:
        if self._status is None:
            self._status = self._console.status(Text(said))
            self._status.start()
        self._status.update(Text(said))


class _Lines:
    """Lines of text about some work."""

    def __init__(self, what: str) -> None:
        self._what, self._printed = what, time.monotonic()

    def tell(self, share: float) -> None:
        """Print a line if the last one is PLAIN_SECONDS old."""
        now = time.monotonic()
        if now - self._printed >= PLAIN_SECONDS and share < 1.0:
            self._printed = now
            _write(f"{self._what}: {share:.0%}")


def _write(line: str) -> None:
    with suppress(OSError, ValueError, AttributeError):  # closed, full or absent, which is no reason to stop
        sys.stderr.write(f"{line}\n")
        sys.stderr.flush()
