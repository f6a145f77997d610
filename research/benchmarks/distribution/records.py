"""A run's metrics.jsonl while it is written: new records, the moving reward, and rates between two of its lines."""

import json
from collections import deque
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

Record = dict[str, Any]


class Tail:
    """Reads the records that have been added to a file since the last look.

    Args:
        path: metrics.jsonl; it may not exist yet.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._read = 0

    def new(self) -> Iterator[Record]:
        """Yield the new whole records."""
        if not self._path.exists():
            return
        with self._path.open("rb") as file:
            file.seek(self._read)
            for line in file:
                if not line.endswith(b"\n"):
                    return
                self._read += len(line)
                yield json.loads(line)


class MovingReward:
    """The mean reward per agent of the newest episodes.

    Args:
        window: number of episodes.
    """

    def __init__(self, window: int) -> None:
        self._window = window
        self._newest: deque[float] = deque(maxlen=window)
        self._episodes = 0

    def add(self, record: Record) -> float | None:
        """Take in a record of kind `episodes`; return the mean, or None before there are enough episodes."""
        count = record["episodes"] - self._episodes
        self._episodes = record["episodes"]
        self._newest.extend([record["reward"]["mean"]] * count)
        return sum(self._newest) / self._window if len(self._newest) == self._window else None


def between(records: Sequence[Record], first: float, last: float) -> tuple[Record, Record]:
    """Return the first and the last record of kind `status` within two times of the learner's clock, s.

    Raises:
        ValueError: there are not two.
    """
    found = [record for record in records if record["kind"] == "status" and first <= record["time"] <= last]
    if len(found) < 2:
        raise ValueError(f"fewer than two reports between {first:.0f} s and {last:.0f} s.")
    return found[0], found[-1]
