"""Ranges of chunk numbers behave like a map of single numbers."""

import itertools
import random

import pytest

from eia_sec.deploy.monitor.chunk_ranges import ChunkRanges, shared_ranges


def filled(seed, most=60):
    """Return ranges after random puts, and the map of single numbers that the same puts make."""
    chance, ranges, single = random.Random(seed), ChunkRanges(), {}
    for _ in range(30):
        first = chance.randrange(1, most)
        last, value = first + chance.choice((0, 0, 1, 5, 30)), chance.choice("xyz")
        ranges.put(first, last, value)
        single.update(dict.fromkeys(range(first, last + 1), value))
    return ranges, single


@pytest.mark.parametrize("seed", range(40))
def test_puts_leave_what_a_map_of_single_numbers_holds(seed):
    """Ranges are disjoint, ordered, joined where their values are equal, and every query agrees with the map."""
    ranges, single = filled(seed)
    parts = list(ranges)
    assert {n: value for first, last, value in parts for n in range(first, last + 1)} == single
    assert sum(last - first + 1 for first, last, _ in parts) == len(single)
    assert all(a[1] < b[0] and (a[1] + 1 < b[0] or a[2] != b[2]) for a, b in itertools.pairwise(parts))
    assert ranges.last == max(single)
    for number in range(100):
        assert ranges.get(number) == single.get(number)
        assert ranges.next_after(number) == min((n for n in single if n > number), default=None)
    inside = [n for first, last, _ in ranges.within(10, 20) for n in range(first, last + 1)]
    assert inside == sorted(n for n in single if 10 <= n <= 20)


@pytest.mark.parametrize("seed", range(20))
def test_shared_ranges_hold_each_number_once_and_one_value_of_each_map(seed):
    """Nothing changes inside a shared range, and a cut begins one."""
    (one, first_map), (two, second_map), cuts = filled(seed), filled(seed + 1000, 90), (7, 23)
    found = list(shared_ranges(one, two, cuts=cuts))
    assert [n for first, last in found for n in range(first, last + 1)] == sorted({*first_map, *second_map})
    for first, last in found:
        assert len({(first_map.get(n), second_map.get(n)) for n in range(first, last + 1)}) == 1
        assert not any(first < cut <= last for cut in cuts)
