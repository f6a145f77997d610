"""Values of chunk numbers, kept by range: one forged line may speak of millions of chunks."""

from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from itertools import pairwise
from typing import Any, Generic, TypeVar

T = TypeVar("T")
Range = tuple[int, int]
"""First and last number, both included."""


class ChunkRanges(Generic[T]):
    """A map from chunk numbers to values that takes time and memory by range, however long a range is."""

    def __init__(self) -> None:
        self._firsts: list[int] = []
        self._lasts: list[int] = []
        self._values: list[T] = []

    def __len__(self) -> int:
        """Return the number of ranges."""
        return len(self._firsts)

    def __iter__(self) -> Iterator[tuple[int, int, T]]:
        """Yield first number, last number and value of each range, in order."""
        return iter(list(zip(self._firsts, self._lasts, self._values, strict=True)))

    @property
    def last(self) -> int:
        """Return the highest number, 0 when there is none."""
        return self._lasts[-1] if self._lasts else 0

    def get(self, number: int) -> T | None:
        """Return the value of a number, or None."""
        at = bisect_right(self._firsts, number) - 1
        return self._values[at] if at >= 0 and number <= self._lasts[at] else None

    def within(self, first: int, last: int) -> list[tuple[int, int, T]]:
        """Return the ranges between two numbers, cut at these."""
        begin, end = bisect_left(self._lasts, first), bisect_right(self._firsts, last)
        found = zip(self._firsts[begin:end], self._lasts[begin:end], self._values[begin:end], strict=True)
        return [(max(first, a), min(last, b), value) for a, b, value in found]

    def put(self, first: int, last: int, value: T) -> None:
        """Give all numbers from first to last a value, in place of any that they had."""
        begin, end = bisect_left(self._lasts, first), bisect_right(self._firsts, last)
        old = list(zip(self._firsts[begin:end], self._lasts[begin:end], self._values[begin:end], strict=True))
        new = [(first, last, value)]
        if old and old[0][0] < first:
            new.insert(0, (old[0][0], first - 1, old[0][2]))
        if old and old[-1][1] > last:
            new.append((last + 1, old[-1][1], old[-1][2]))
        if begin and self._lasts[begin - 1] + 1 == first:
            begin -= 1
            new.insert(0, (self._firsts[begin], first - 1, self._values[begin]))
        if end < len(self._firsts) and self._firsts[end] == last + 1:
            new.append((last + 1, self._lasts[end], self._values[end]))
            end += 1
        for at in range(len(new) - 1, 0, -1):
            if new[at][2] == new[at - 1][2]:
                new[at - 1 : at + 1] = [(new[at - 1][0], new[at][1], new[at][2])]
        self._firsts[begin:end] = [part[0] for part in new]
        self._lasts[begin:end] = [part[1] for part in new]
        self._values[begin:end] = [part[2] for part in new]

    def next_after(self, number: int) -> int | None:
        """Return the first number beyond this one that has a value, or None."""
        at = bisect_right(self._lasts, number)
        return None if at == len(self._firsts) else max(number + 1, self._firsts[at])


def shared_ranges(*maps: ChunkRanges[Any], cuts: tuple[int, ...] = ()) -> Iterator[Range]:
    """Yield in order the longest ranges in which no map changes and no range but a first number is in `cuts`.

    Args:
        maps: each range lies in one of their ranges at least.
        cuts: numbers at which a range begins in any case.
    """
    starts = {*cuts}
    for each in maps:
        for first, last, _ in each:
            starts |= {first, last + 1}
    ordered = sorted(starts)
    for first, after in pairwise(ordered):
        if any(each.get(first) is not None for each in maps):
            yield first, after - 1
