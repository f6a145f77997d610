"""The imitation schedule fires when reading A1 says."""

import pytest

from eia_sec.common.config import EliteConfig
from eia_sec.common.errors import SchemaError
from eia_sec.common.imitation import ImitationEvent, ImitationSchedule
from eia_sec.common.team import GroupSpec, TeamSpec


def episodes(schedule: ImitationSchedule, last: int) -> list[int]:
    found, applied = [], 0
    for episode in range(1, last + 1):
        if schedule.is_due(applied, episode):
            found.append(episode)
            applied += 1
    return found


def test_default_schedule() -> None:
    """Delta divides lambda: 10, 20, 40 ... 1280, with vartheta halved each time."""
    schedule = ImitationSchedule(EliteConfig())
    assert episodes(schedule, 2000) == [10, 20, 40, 80, 160, 320, 640, 1280]
    assert [schedule.rate(event) for event in (1, 2, 3)] == [0.1, 0.05, 0.025]


def test_default_schedule_pulls_as_the_readings_say() -> None:
    """The eight events of 2000 episodes pull 18.6 % in all."""
    schedule = ImitationSchedule(EliteConfig())
    kept = 1.0
    for event in range(1, 9):
        kept *= 1.0 - schedule.rate(event)
    assert round(100 * (1 - kept), 1) == 18.6


def test_growth_of_one_repeats() -> None:
    """With growth 1 and decay 1 every tenth episode brings an event of equal strength."""
    schedule = ImitationSchedule(EliteConfig(cycle_growth=1.0, rate_decay=1.0))
    assert episodes(schedule, 35) == [10, 20, 30]
    assert schedule.rate(3) == 0.1


def test_disabled_never_fires() -> None:
    """Without elite imitation nothing is ever due."""
    assert episodes(ImitationSchedule(EliteConfig(enabled=False)), 100) == []


def test_the_schedule_begins_when_agents_part() -> None:
    """While agents share their actors nothing is due; then cycles are counted from where they part."""
    schedule = ImitationSchedule(EliteConfig())
    assert episodes(schedule.after(None), 100) == []
    assert episodes(schedule.after(75), 200) == [80, 100, 120, 160]
    assert episodes(schedule.after(0), 200) == episodes(schedule, 200)


def test_an_event_that_was_missed_is_due_later() -> None:
    """Episodes may finish several at once; the event is due from its episode on until it is applied."""
    schedule = ImitationSchedule(EliteConfig())
    assert not schedule.is_due(0, 8)
    assert schedule.is_due(0, 16)
    assert not schedule.is_due(1, 16)


@pytest.mark.parametrize("steps", [-1, 2**48 + 1, 2**62])
def test_an_event_that_no_checkpoint_could_hold_is_refused(steps: int) -> None:
    """The steps of evaluations are added up, and the sum is saved."""
    team = TeamSpec((GroupSpec("one", 2, 3, 2),))
    ImitationEvent(1, 1, 10, 0.1, (0,), ((0.5, 0.5),), 2**48).check(team)
    with pytest.raises(SchemaError, match="evaluation"):
        ImitationEvent(1, 1, 10, 0.1, (0,), ((0.5, 0.5),), steps).check(team)
