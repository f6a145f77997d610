"""Recorded experience for the players. Standard library and NumPy only, because the peers use it too."""

import json
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

CAPACITY: Final = 65_536
"""Rows of every sink's replay."""
NAMES: Final = ("observation", "action", "reward")
Arrays = dict[str, NDArray[np.float32]]


def read(folder: Path) -> Arrays:
    """Return the arrays of a recorded chunk, [rows, size] each."""
    shapes = json.loads((folder / "shapes.json").read_text(encoding="utf-8"))
    return {
        name: np.fromfile(folder / f"{name}.f4", np.float32, int(np.prod(shapes[name]))).reshape(shapes[name])
        for name in NAMES
    }


def steps_in_rows(folder: Path) -> float:
    """Return how many of a recorded chunk's rows are steps; the others only end a segment."""
    shapes = json.loads((folder / "shapes.json").read_text(encoding="utf-8"))
    return float(shapes["steps"] / shapes["reward"][0])


class Ring:
    """A preallocated replay: what every peer's sink does with a chunk.

    Attributes:
        rows: rows that were added.
        bytes: bytes that were added.
    """

    def __init__(self, like: Arrays) -> None:
        self._arrays = {name: np.zeros((CAPACITY, array.shape[1]), np.float32) for name, array in like.items()}
        self._head = self.rows = self.bytes = 0

    def add(self, arrays: dict[str, Any]) -> None:
        """Copy a chunk in, over the oldest rows where the ring is full."""
        count = len(arrays["reward"])
        first = min(count, CAPACITY - self._head)
        for name, ring in self._arrays.items():
            source = np.asarray(arrays[name])
            ring[self._head : self._head + first] = source[:first]
            ring[: count - first] = source[first:]
            self.bytes += source.nbytes
        self._head = (self._head + count) % CAPACITY
        self.rows += count


class Window:
    """Counts what is taken in from a while after the first chunk on.

    Args:
        taken: returns environment steps and bytes so far.
        seconds: how long to count, after a warm-up of a third of it.
        patience: seconds that the first chunk may take to come.
    """

    def __init__(self, taken: Callable[[], tuple[int, int]], seconds: float, patience: float = 90.0) -> None:
        self._taken, self._seconds = taken, seconds
        self._limit = time.perf_counter() + patience
        self._begin = self._started = 0.0
        self._before = (0, 0)

    def over(self) -> bool:
        """Look at the clock; return whether counting has ended.

        Raises:
            TimeoutError: nothing came.
        """
        now = time.perf_counter()
        if self._begin == 0.0:
            if self._taken()[0] > 0:
                self._begin = now + self._seconds / 3.0
            elif now > self._limit:
                raise TimeoutError("nothing came.")
            return False
        if self._started == 0.0:
            if now >= self._begin:
                self._started, self._before = now, self._taken()
            return False
        return now >= self._started + self._seconds

    def report(self, share: float = 1.0) -> dict[str, float]:
        """Return environment steps and megabytes a second; `share` of what was counted are steps."""
        elapsed = time.perf_counter() - self._started
        rows, size = (after - before for after, before in zip(self._taken(), self._before, strict=True))
        return {"env_steps_per_second": rows * share / elapsed, "mb_per_second": size / elapsed / 1e6}


def write_result(result: dict[str, float]) -> None:
    """Print a result as the last line, which the driver reads."""
    sys.stdout.write("\n" + json.dumps(result) + "\n")
    sys.stdout.flush()
