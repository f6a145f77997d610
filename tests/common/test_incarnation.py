"""Incarnations grow with every start, whatever clocks say, and cannot be used up."""

import time

import pytest

from eia_sec.common.errors import UsageError
from eia_sec.common.incarnation import LATEST, LIMIT, STRIDE, new_incarnation, plausible, seconds_ahead

DAY = 86_400_000_000


def test_a_start_takes_the_clocks_number():
    """Microseconds since 1970, where no earlier start has a greater number."""
    before = time.time_ns() // 1000
    assert before <= new_incarnation() <= time.time_ns() // 1000
    assert new_incarnation(before - DAY) >= before


def test_a_start_goes_beyond_an_earlier_one_whose_clock_was_ahead():
    """The new number is greater, by less than a second and a half of clock, and two starts at once differ."""
    known = time.time_ns() // 1000 + DAY
    numbers = {new_incarnation(known) for _ in range(20)}
    assert all(known < number <= known + STRIDE for number in numbers)
    assert len(numbers) > 15
    assert seconds_ahead(known) == pytest.approx(86_400.0, abs=5.0)
    assert seconds_ahead(known - 2 * DAY) == 0.0


def test_a_clock_beyond_all_bounds_gives_a_number_that_is_taken(monkeypatch):
    """Whatever the clock says, an honest start's number is plausible to a learner that knows none."""
    monkeypatch.setattr("eia_sec.common.clock.time.time_ns", lambda: 2**63 - 1)
    assert plausible(new_incarnation(), 0)
    assert plausible(new_incarnation(LATEST), LATEST)


def test_what_no_honest_start_has_is_not_plausible():
    """Numbers end at LATEST, or STRIDE beyond the greatest that is known."""
    assert plausible(LATEST, 0)
    assert not plausible(LATEST + STRIDE + 1, LATEST)
    assert not plausible(LIMIT - 1, 0)


def test_when_no_number_is_left_a_sentence_says_so():
    """The last number may be taken, however unlikely that is."""
    with pytest.raises(UsageError, match="no greater one is left"):
        new_incarnation(LIMIT - 1)
