"""How far work has come that takes seconds, on standard error: a bar on a terminal, else a line now and then."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Final

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

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


class _Lines:
    """Lines of text about some work."""

    def __init__(self, what: str) -> None:
        self._what, self._printed = what, time.monotonic()

    def tell(self, share: float) -> None:
        """Print a line if the last one is PLAIN_SECONDS old."""
        now = time.monotonic()
        if now - self._printed >= PLAIN_SECONDS and share < 1.0:
            self._printed = now
            with suppress(OSError, ValueError, AttributeError):  # closed, full or absent, which is no reason to stop
                sys.stderr.write(f"{self._what}: {share:.0%}\n")
                sys.stderr.flush()
