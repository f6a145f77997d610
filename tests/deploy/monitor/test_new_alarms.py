"""Without a terminal each alarm is said once, with its text."""

from dataclasses import replace

from rich.console import Console

from eia_sec.deploy.monitor.live_view import render
from eia_sec.deploy.monitor.new_alarms import SAID, STANDING_SECONDS, NewAlarms
from eia_sec.deploy.monitor.snapshot import Snapshot

SHOWN = Snapshot("run", episodes_total=10)


class Alarms(NewAlarms):
    """Shows what is said of alarms that go on standing."""

    def __init__(self):
        self.now = 0.0
        super().__init__(lambda: self.now)

    def standing(self, *texts):
        snapshot = replace(SHOWN, alarms=texts)
        said = self.of(snapshot)
        self.now += STANDING_SECONDS
        return said + self.of(snapshot)


def test_an_alarm_is_said_once_however_its_numbers_grow():
    """An alarm about another process is another one."""
    alarms = Alarms()
    assert alarms.standing() == []
    first = ("rollout 0 has been silent for 5 s.", "1,200 environment steps were lost with processes that died.")
    assert alarms.standing(*first) == [f"alarm: {text}" for text in first]
    grown = ("rollout 0 has been silent for 6.5 s.", "9,000 environment steps were lost with processes that died.")
    assert alarms.standing(*grown) == []
    other = "rollout 1 has been silent for 5 s."
    assert alarms.standing(*grown, other) == [f"alarm: {other}"]


def test_an_alarm_that_vanishes_at_once_is_not_said():
    """When a run ends, its processes are gone a moment before their monitor hears that it is over."""
    alarms = Alarms()
    assert alarms.of(replace(SHOWN, alarms=("elite coordinator is gone.",))) == []
    alarms.now += STANDING_SECONDS
    assert alarms.standing() == []


def test_many_alarms_are_counted():
    """No flood of alarms hides the others."""
    texts = tuple(f"worker {'x' * k} is blocked" for k in range(SAID + 3))
    assert Alarms().standing(*texts)[-1] == "alarm: and 3 more."


def test_the_smallest_live_view_shows_which_alarm_there_is():
    """At 80 x 24 the text of an alarm is on the screen."""
    console = Console(width=80, height=24, record=True)
    console.print(render(replace(SHOWN, alarms=("worker 0 is blocked after 20 bad requests in a row",)), 24))
    assert "worker 0 is blocked after 20 bad requests in a row" in console.export_text()
