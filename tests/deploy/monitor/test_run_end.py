"""What the monitor says of processes that leave when a run is over."""

import pytest

from eia_sec.common.process import Presence
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.deploy.monitor.run_monitor import RunMonitor
from tests.system.fleet import until


@pytest.mark.parametrize(
    ("state", "episodes", "gone"),
    [("training", 71, True), ("training", 72, False), ("finished", 72, False), ("draining", 40, False)],
)
def test_who_leaves_a_run_that_is_over_is_no_alarm(state, episodes, gone):
    """A coordinator that leaves is one while there are episodes to fly, and none when the run is done or drains."""
    endpoint = free_endpoint()
    with Bus.listen(endpoint, "control") as bus, Bus.connect(endpoint, "control", 10.0) as away:
        monitor = RunMonitor(bus, "r")
        learner = Presence(bus, "r", "learner", "learner", 1)
        coordinator = Presence(away, "r", "elite", "coordinator", 1)
        values = {"state": state, "episodes": episodes, "episodes_total": 72, "progress": episodes / 72, "elapsed": 1.0}

        def seen(alive: bool) -> bool:
            learner.report(values)
            if alive:
                coordinator.report({})
            monitor.update()
            found = monitor.snapshot()
            known = {row.role: row.alive for row in found.processes}
            return known == {"learner": True, "elite": alive} and found.episodes == episodes

        until(lambda: seen(alive=True), "both processes")
        assert monitor.snapshot().alarms == ()
        away.close()
        until(lambda: seen(alive=False), "a coordinator that has left")
        assert monitor.snapshot().alarms == (("elite coordinator is gone.",) if gone else ())


def test_a_resumed_learner_waits_for_a_share_of_its_own_time():
    """Waits are counted since a start of the learner, so they are divided by that start's time, not by the run's."""
    endpoint = free_endpoint()
    with Bus.listen(endpoint, "control") as bus:
        monitor = RunMonitor(bus, "r")
        learner = Presence(bus, "r", "learner", "learner", 1)
        values = {"state": "training", "elapsed": 1e6, "waits": {"data": 1e3}}

        def seen() -> bool:
            learner.report(values)
            monitor.update()
            return monitor.snapshot().elapsed == values["elapsed"]

        until(seen, "the learner")
        assert monitor.snapshot().learner_wait == 1.0


def test_each_evaluation_of_the_coordinator_is_one_point():
    """Reports come each second and evaluations each minute; one that scores as before is a point too.

    A coordinator that has lost the lead goes on reporting its last one.
    """
    endpoint = free_endpoint()
    with Bus.listen(endpoint, "control") as bus:
        monitor = RunMonitor(bus, "r")
        first, second = (Presence(bus, "r", "elite", name, 1) for name in ("coordinator", "spare"))
        points = [(first, 1, 700.0), (first, 1, 700.0), (first, 2, 815.0), (first, 3, 815.0), (first, 3, 815.0)]
        points += [(second, 1, 850.0), (first, 3, 815.0), (second, 1, 850.0), (second, 2, 860.0)]
        for events, (elite, number, reward) in enumerate(points, 1):
            values = {"next_episode": events, "noise_free": {"number": number, "reward": reward}}

            def seen(elite=elite, values=values):
                elite.report(values)
                monitor.update()
                return values["next_episode"] in {
                    report.values.get("next_episode") for report in monitor._reports.values()
                }

            until(seen, "the coordinator")
        assert monitor.snapshot().noise_free.values == (700.0, 815.0, 815.0, 850.0, 860.0)
        assert monitor.snapshot().noise_free.latest == 860.0
