"""A lower epoch is followed when nothing else speaks, and never before."""

from eia_sec.common.protocol.epoch_fence import PATIENCE_SECONDS, EpochFence


class Clock:
    """Seconds that stand still until the test moves them."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_higher_and_equal_epochs_are_admitted_at_once() -> None:
    """The first learner, the followed one and a later one need no patience."""
    fence = EpochFence(Clock())
    assert [fence.admits(5, 0), fence.admits(5, 5), fence.admits(6, 5)] == [True, True, True]
    assert fence.alarm == ""


def test_a_replaced_learner_is_ignored_while_its_successor_speaks() -> None:
    """However long the replaced one goes on; the alarm is there only until the successor is heard again."""
    clock = Clock()
    fence = EpochFence(clock)
    for _ in range(10):
        assert not fence.admits(5, 6)
        assert "lower epoch" in fence.alarm
        clock.now += 0.9 * PATIENCE_SECONDS
        assert fence.admits(6, 6)
        assert fence.alarm == ""


def test_a_process_that_was_frozen_does_not_follow_the_first_that_it_hears() -> None:
    """Time in which it could hear nobody does not count as silence of the learner that it follows."""
    clock = Clock()
    fence = EpochFence(clock)
    assert fence.admits(6, 6)
    clock.now += 100 * PATIENCE_SECONDS
    assert not fence.admits(5, 6)
    assert fence.admits(6, 6)


def test_a_lower_epoch_that_alone_speaks_is_followed_after_a_while() -> None:
    """The alarm says that it is being ignored, until it is followed."""
    clock = Clock()
    fence = EpochFence(clock)
    assert fence.admits(6, 0)
    admitted = []
    for _ in range(4):
        admitted.append(fence.admits(5, 6))
        clock.now += PATIENCE_SECONDS / 3 + 0.01
    assert admitted == [False, False, False, True]
    assert fence.alarm == ""
    assert fence.admits(5, 5)
