"""Late imitation events hold new experience back for a while and raise an alarm."""

from eia_sec.common.config import EliteConfig
from eia_sec.common.imitation import ImitationSchedule
from eia_sec.learner.process.event_deadline import ALARM_SECONDS, HOLD_SECONDS, EventDeadline


def deadline(**settings: object) -> EventDeadline:
    """Return the watch over a schedule of 10, 20, 40, 80 ... episodes."""
    return EventDeadline(ImitationSchedule(EliteConfig(**settings)))


def test_an_event_holds_from_a_cycle_after_its_episode_until_it_is_applied():
    """Event 1 is due at 10 and late at 20; once it is applied event 2, due at 20, is late at 40."""
    watch = deadline()
    assert not watch.holds(0, 19, 0, expected=True, now=100.0)
    assert watch.holds(0, 20, 0, expected=True, now=100.0)
    assert not watch.holds(1, 39, 0, expected=True, now=101.0)
    assert watch.holds(1, 40, 0, expected=True, now=101.0)


def test_a_hold_ends_after_its_longest_time_and_begins_anew_with_the_next_event():
    """A coordinator that never comes costs one hold; one that comes back is waited for again."""
    watch = deadline()
    assert watch.holds(0, 20, 0, expected=True, now=100.0)
    assert watch.holds(0, 20, 0, expected=True, now=100.0 + HOLD_SECONDS - 0.1)
    assert not watch.holds(0, 20, 0, expected=True, now=100.0 + HOLD_SECONDS)
    assert not watch.holds(0, 500, 0, expected=True, now=5000.0)
    assert watch.holds(1, 500, 0, expected=True, now=5000.0)


def test_nobody_is_waited_for_who_is_not_expected():
    """A learner on its own goes on, and an alarm says that the event has not come."""
    watch = deadline()
    assert not watch.holds(0, 20, 0, expected=False, now=100.0)
    assert watch.alarm(0, 25, 0, able=True, now=100.0) == ""
    assert watch.alarm(0, 25, 0, able=True, now=100.0 + ALARM_SECONDS - 0.1) == ""
    assert "event 1 was due at episode 10" in watch.alarm(0, 25, 0, able=True, now=100.0 + ALARM_SECONDS)
    assert watch.alarm(1, 25, 0, able=True, now=101.0 + ALARM_SECONDS) == ""


def test_a_learner_that_updates_is_not_waited_for():
    """While an iteration's updates run no event can be applied, so their time raises no alarm."""
    watch = deadline()
    assert watch.alarm(0, 25, 0, able=True, now=100.0) == ""
    assert watch.alarm(0, 25, 0, able=False, now=100.0 + ALARM_SECONDS) == ""
    assert watch.alarm(0, 25, 0, able=True, now=101.0 + ALARM_SECONDS) == ""
    assert watch.alarm(0, 25, 0, able=True, now=101.0 + 2 * ALARM_SECONDS)


def test_time_between_updates_adds_up():
    """A learner that is able for 2 s and updates for 1 s, over and over, raises the alarm after the third time."""
    watch = deadline()
    said = [watch.alarm(0, 25, 0, able=second % 4 != 3, now=100.0 + second) for second in range(11)]
    assert [bool(sentence) for sentence in said] == [False] * 9 + [True] * 2
    assert watch.alarm(1, 45, 0, able=True, now=111.0) == ""


def test_nothing_is_late_while_agents_share_their_actors():
    """Nothing is held before they part, and cycles count from there."""
    watch = deadline()
    assert not watch.holds(0, 1000, None, expected=True, now=0.0)
    assert not watch.holds(0, 1019, 1000, expected=True, now=1.0)
    assert watch.holds(0, 1020, 1000, expected=True, now=2.0)


def test_nothing_is_late_without_imitation():
    """Runs without imitation hold nothing."""
    assert not deadline(enabled=False).holds(0, 1000, 0, expected=True, now=0.0)
