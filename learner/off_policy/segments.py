"""Finds the segments of a new chunk that continue segments of the same worker's previous chunk.

A worker cuts its environments' trajectories into chunks. The observation at a cut is in both chunks: as the last row of
the earlier segment and as the first row of the later one. Replay stores it once. The two rows are the same if the
chunks' numbers are consecutive and the observations are bit-equal. Otherwise, for example after a lost chunk, the later
segment starts anew.
"""

from typing import Any, Final

import numpy as np
import xxhash
from numpy.typing import NDArray

from eia_sec.common.errors import CheckpointError
from eia_sec.common.transitions import TERMINATED, TRANSITION, TRUNCATED, Rows

MAX_SOURCES = 4096
"""Most sources whose open ends are remembered; beyond that, the least recent one is forgotten."""

Indices = NDArray[np.int64]
_FIRST: Final[Indices] = np.zeros(1, np.int64)


def segment_starts(flag: NDArray[np.uint8]) -> Indices:
    """Return the first row of each segment."""
    return np.concatenate((_FIRST, _last_rows(flag)[:-1] + 1))


def open_ends(flag: NDArray[np.uint8]) -> Indices:
    """Return the last row of each segment whose episode is not over."""
    last = _last_rows(flag)
    going: Indices = last[(flag[last - 1] & (TERMINATED | TRUNCATED)) == 0]
    return going


def _last_rows(flag: NDArray[np.uint8]) -> Indices:
    """Return the last row of each segment, which follows its last step."""
    rows: Indices = np.flatnonzero((flag & TRANSITION) == 0)
    return rows


class OpenEnds:
    """The last rows of open segments in each source's newest chunk, by running number."""

    def __init__(self) -> None:
        self._ends: dict[str, tuple[int, list[tuple[str, int]]]] = {}

    def continued(self, rows: Rows, source: str, number: int) -> tuple[Indices, Indices]:
        """Return which rows of a chunk are already in the ring.

        Args:
            rows: the chunk.
            source: name of its producer; empty if none of its segments is ever continued.
            number: its number among the chunks of that source.

        Returns:
            First rows of segments, and for each the running number of the row that already holds its observation.
        """
        before, ends = self._ends.pop(source, (0, []))
        if number != before + 1 or not ends:
            return np.zeros(0, np.int64), np.zeros(0, np.int64)
        known: dict[str, list[int]] = {}
        for name, row in ends:
            known.setdefault(name, []).append(row)
        found = []
        for start in segment_starts(rows.flag).tolist():
            candidates = known.get(_name(rows.observation[start]))
            if candidates and rows.flag[start] & TRANSITION:
                found.append((start, candidates.pop(0)))
        pairs = np.array(found, np.int64).reshape(len(found), 2)
        return pairs[:, 0], pairs[:, 1]

    def remember(self, rows: Rows, numbers: Indices, source: str, number: int) -> None:
        """Remember a chunk's open ends; `numbers` are the running numbers of its rows."""
        if not source:
            return
        ends = [(_name(rows.observation[row]), int(numbers[row])) for row in open_ends(rows.flag).tolist()]
        self._ends[source] = (number, ends)
        if len(self._ends) > MAX_SOURCES:
            del self._ends[next(iter(self._ends))]

    def state(self) -> dict[str, Any]:
        """Return the open ends as plain values."""
        return {source: [number, [list(end) for end in ends]] for source, (number, ends) in self._ends.items()}

    def restore(self, state: Any, written: int) -> None:
        """Continue from `state`.

        Args:
            state: what `state` returned.
            written: rows ever written into the ring; running numbers are below it.

        Raises:
            CheckpointError: when the state is malformed.
        """
        try:
            if len(state) > MAX_SOURCES:
                raise ValueError(f"{len(state)} sources")
            self._ends = {
                str(source): (_count(number, 2**63), [(str(name), _count(row, written)) for name, row in ends])
                for source, (number, ends) in state.items()
            }
        except (AttributeError, TypeError, ValueError) as error:
            raise CheckpointError(f"the replay buffer's open segments are not readable: {error}.") from error


def _count(value: Any, limit: int) -> int:
    if type(value) is not int or not 0 <= value < limit:
        raise ValueError("a number is out of range")
    return value


def _name(observation: NDArray[np.float32]) -> str:
    return xxhash.xxh3_128_hexdigest(np.ascontiguousarray(observation).data)
