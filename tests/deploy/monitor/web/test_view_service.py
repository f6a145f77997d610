"""A worker shows its farm to whoever asks, for as long as they ask, and no faster than it may."""

import pytest

from eia_sec.common.protocol.messages import WatchTerms
from eia_sec.rollout.worker.view_service import GREETING_SECONDS, LEASE_SECONDS, MAX_WATCHERS, STEPS_PER_SECOND
from tests.deploy.monitor.web.stage import CONFIG, AWorker

STEPS = CONFIG.farm.world.steps


def frames(worker):
    return sum(len(view.position) for view in worker.bus.views)


def test_nothing_is_published_unless_somebody_asks():
    """A worker that nobody watches has no probe in its collector and publishes nothing."""
    worker = AWorker()
    worker.fly(20)
    assert (worker.bus.views, worker.collector.probe, worker.view_service.watchers) == ([], None, 0)


def test_a_watcher_sees_the_running_episode_at_once_and_then_whole_ones():
    """The first frames are of the step that follows the request, later stretches begin with an episode."""
    worker = AWorker()
    worker.fly(1)
    request = worker.bus.ask("a")
    worker.fly(1)
    assert WatchTerms.decode(request.answer).steps_per_second == STEPS_PER_SECOND
    worker.fly(3, seconds=0.4)  # 25 steps a second: as fast as may be
    assert worker.bus.views[0].first == 11
    for _ in range(20):
        worker.bus.ask("a")
        worker.fly(1, seconds=0.4)
    views = worker.bus.views
    starts = [view.first for view, before in zip(views[1:], views, strict=False) if view.episode != before.episode]
    assert len(starts) >= 3
    assert set(starts) == {0}
    assert worker.view_service.skipped == 0


def test_a_watcher_is_served_while_a_chunk_is_collected():
    """Whoever asks in the middle of a chunk is answered there and sees its next steps, and the counts are right."""
    worker, frames_at = AWorker(), []

    def goes_on():
        steps = worker.collector.simulated // 2
        if steps == 4:
            worker.bus.ask("a")
        worker.view_service.poll(3, 0.1, False)
        frames_at.append((steps, frames(worker)))
        return True

    worker.collector.collect(worker.actors, 0.1, False, goes_on=goes_on)
    assert frames_at == [(step, max(0, step - 4)) for step in range(1, 11)]
    assert worker.view_service.skipped == 0


def test_it_stops_when_the_lease_ends():
    """A watcher that is gone without a word costs nothing more after LEASE_SECONDS."""
    worker = AWorker()
    worker.bus.ask("a")
    worker.fly(2, seconds=0.1)
    worker.now += LEASE_SECONDS
    worker.fly(1)
    seen = frames(worker)
    worker.fly(30)
    assert frames(worker) == seen
    assert (worker.collector.probe, worker.view_service.watchers) == (None, 0)


def test_it_stops_at_once_when_the_last_watcher_says_so():
    """Of two watchers one may go and the other still sees; when both are gone, nothing is published."""
    worker = AWorker()
    worker.bus.ask("a")
    worker.bus.ask("b")
    worker.fly(2, seconds=0.4)
    worker.bus.ask("a", stay=False)
    worker.fly(2, seconds=0.4)
    assert worker.view_service.watchers == 1
    worker.bus.ask("b", stay=False)
    worker.fly(1, seconds=0.4)
    seen = frames(worker)
    worker.fly(10, seconds=0.4)
    assert (frames(worker), worker.view_service.watchers, worker.collector.probe) == (seen, 0, None)


@pytest.mark.parametrize(("seconds", "chunks"), [(0.01, 400), (0.05, 300), (1.0, 60)])
def test_the_rate_is_bounded_and_what_is_not_shown_is_counted(seconds, chunks):
    """Any worker publishes STEPS_PER_SECOND on average at most, and shown and skipped make what is flown."""
    worker, started = AWorker(), 100.0
    for _ in range(chunks):
        worker.bus.ask("a")
        worker.fly(1, seconds=seconds)
    allowed = (worker.now - started) * STEPS_PER_SECOND
    assert 0 < frames(worker) <= allowed + 2 * STEPS + STEPS_PER_SECOND
    worker.view_service.poll(3, 0.1, False)
    resets = sum(view.first == 0 for view in worker.bus.views)
    assert frames(worker) - resets + worker.view_service.skipped == worker.collector.environment_steps // 2
    assert (worker.view_service.skipped > 0) == (seconds < 0.4)
    assert worker.bus.sequences == list(range(1, len(worker.bus.views) + 1))


def test_a_new_watcher_does_not_wait_for_the_allowance():
    """Somebody who comes while the worker rests gets the next episode; those who follow at once wait."""
    worker = AWorker()
    worker.bus.ask("a")
    worker.fly(60, seconds=0.001)
    rested = len(worker.bus.views)
    worker.fly(60, seconds=0.001)
    assert len(worker.bus.views) == rested
    worker.now += GREETING_SECONDS
    worker.bus.ask("a")
    worker.bus.ask("b")
    worker.fly(20, seconds=0.001)
    greeted = len(worker.bus.views)
    assert worker.bus.views[rested].first == 0
    worker.bus.ask("c")
    worker.fly(20, seconds=0.001)
    assert len(worker.bus.views) == greeted


def test_too_many_watchers_and_strange_requests_are_refused():
    """There is room for MAX_WATCHERS; what is no request gets a reason."""
    worker = AWorker()
    asked = [worker.bus.ask(f"w{k}") for k in range(MAX_WATCHERS + 1)]
    odd = [worker.bus.ask("a/b"), worker.bus.ask("x" * 200)]
    spoilt = worker.bus.ask("a")
    spoilt.payload = spoilt.payload[:-1]
    worker.fly(1)
    assert [bool(request.answer) for request in asked] == [True] * MAX_WATCHERS + [False]
    assert "watching already" in asked[-1].refusal
    assert all(request.refusal and request.answer is None for request in (*odd, spoilt))
    assert worker.view_service.refused == 4
    assert worker.view_service.watchers == MAX_WATCHERS
