"""What odd or hostile figures of others do to the view of a fleet: nothing but a count."""

import io
import json
import time

import pytest
from rich.console import Console

import deploy.monitor.run_monitor
from common.protocol.messages import Envelope, MetricMessage
from common.transport.bus import Bus
from common.transport.endpoint import free_endpoint
from deploy.commands.monitoring.monitor import record
from deploy.monitor.live_view import render, summary
from deploy.monitor.run_monitor import Fleet
from deploy.monitor.sanitised import MOST_PARTS, figures, plain

SOUND = {
    "state": "training",
    "episodes": 10,
    "episodes_total": 72,
    "elapsed": 5.0,
    "environment_steps": 100,
    "curves": {"reward": {"mean": 1.0}, "steps": 5.0},
}


@pytest.fixture
def fleet():
    """A view of a run in which nobody lives yet."""
    with Bus.listen(free_endpoint(), "control") as bus:
        yield Fleet(bus, "r")


def tell(fleet, role, values, name="x", counter=1):
    """Have a process tell its figures, as if its message had just come; return whether the view took it."""
    try:
        message = MetricMessage(counter, "host", 1, float(counter), values)
        fleet._take((role, name), Envelope(role, name, 1, counter, 1), message, time.monotonic())
    except deploy.monitor.run_monitor.UNREADABLE:
        return False
    return True


def drawn(fleet):
    """Return the view at the width that shows every column, its one line, and its JSON, none of which may fail."""
    snapshot = fleet.snapshot()
    console = Console(width=160, height=60, file=io.StringIO())
    console.print(render(snapshot, 60))
    console.print(summary(snapshot), markup=False)
    json.dumps(record(snapshot), allow_nan=False)
    return console.file.getvalue()


@pytest.mark.parametrize(
    "odd",
    [
        {"episodes": "x"},
        {"episodes": b"x"},
        {"episodes": [1]},
        {"queue": {}},
        {"environment_steps": None},
        {"alarms": 5},
        {"alarms": [5]},
        {"ledgers": 5},
        {"ledgers": {"a": 5}},
        {"ledger": {"produced": "x"}},
        {"waits": [1]},
        {"elites": {"m": "x"}},
        {"imitations": [{}]},
        {"rate": "x"},
        {"failures": "x"},
        {"x": [[]] * MOST_PARTS},
    ],
)
@pytest.mark.parametrize("role", ["rollout", "elite", "learner"])
def test_figures_that_are_none_cost_their_own_sender_alone(fleet, odd, role):
    """Such a message counts as unreadable, and whatever else is known is shown."""
    assert tell(fleet, "learner", {**SOUND, "alarms": ["no checkpoint"]}, "learner")
    assert not tell(fleet, role, odd)
    shown = drawn(fleet)
    assert "10 of 72 episodes" in shown
    assert "no checkpoint" in shown


def test_what_is_kept_of_a_process_is_small(fleet):
    """Of earlier reports only counters are kept, and of many alarms the first are shown and the others counted."""
    for counter in range(1, 100):
        assert tell(
            fleet, "rollout", {"environment_steps": counter, "alarms": ["a"] * 30, "x": [0] * 1000}, counter=counter
        )
    seen = fleet._seen["rollout", "x"]
    assert seen.message.values == {}
    assert {name for _, kept in seen.track for name in kept} == set(deploy.monitor.run_monitor.COUNTERS)
    assert fleet.snapshot().processes[0].rate == 1.0
    assert [text for text in fleet.snapshot().alarms if text.startswith("rollout x")] == [
        *["rollout x: a"] * deploy.monitor.run_monitor.MOST_ALARMS,
        f"rollout x: {30 - deploy.monitor.run_monitor.MOST_ALARMS} more alarms.",
    ]


@pytest.mark.parametrize(
    "odd",
    [
        {"elapsed": float("inf")},
        {"elapsed": float("nan")},
        {"elapsed": 1e300, "episodes_total": 2**62},
        {"curves": {"reward": {"mean": float("nan"), "[/x]": 2.0}, "steps": float("inf")}},
        {"curves": {"reward": 3}},
        {"curves": {"reward": {"mean": "high"}}},
        {"alarms": ["\x1b[2J[bold]", 7]},
        {"ledgers": {"[/]": {"produced": "many"}}},
        {"ledger": [1]},
        {"imitations": [{"event": 1, "episode": 1, "rate": 0.1, "elites": {"[/m]": 0}, "scores": {"[/m]": [1e999]}}]},
        {"imitations": [{"event": 1}]},
        {"waits": {"data": "long"}},
    ],
)
def test_odd_figures_of_the_learner_end_no_view(fleet, odd):
    """They are left out or make the view do without this message; nothing is obeyed as markup or by the terminal."""
    tell(fleet, "learner", SOUND | odd, "learner")
    assert "\x1b" not in drawn(fleet)
    tell(fleet, "learner", SOUND, "learner", counter=2)
    assert "10 of 72 episodes" in drawn(fleet)


def test_rows_and_curves_are_bounded(fleet, monkeypatch):
    """Names without end take no memory without end, and who is turned away is counted by the caller."""
    monkeypatch.setattr(deploy.monitor.run_monitor, "MOST_ROWS", 3)
    monkeypatch.setattr(deploy.monitor.run_monitor, "MOST_CURVES", 2)
    assert [tell(fleet, "rollout", {}, str(index)) for index in range(5)] == [True] * 3 + [False] * 2
    assert len(fleet.snapshot().processes) == 3
    many = {"curves": {"reward": {str(index): 1.0 for index in range(9)}}}
    fleet._seen.clear()
    assert not tell(fleet, "learner", many, "learner")
    assert len(fleet.snapshot().reward) == 2


def test_a_process_without_a_token_goes_when_it_has_long_been_silent(fleet, monkeypatch):
    """Metrics alone make a row, for as long as they come."""
    tell(fleet, "rollout", {})
    fleet.update()
    assert len(fleet.snapshot().processes) == 1
    monkeypatch.setattr(deploy.monitor.run_monitor, "GONE_SECONDS", 0.0)
    fleet.update()
    assert fleet.snapshot().processes == ()


def test_what_is_left_of_figures():
    """Numbers that are finite and no larger than any of ours, texts that print, maps and lists; of bytes nothing."""
    deep = {"a": {"b": {"c": {"d": {"e": {"f": {"g": {"h": 1}}}}}}}}
    values = {"x": 1, "y": 2.5, "on": True, "nan": float("nan"), "big": 10**16, "bytes": b"x", "none": None}
    assert figures({**values, "list": [1, float("inf"), "a\nb"]}) == {
        **{"x": 1, "y": 2.5, "on": True},
        "list": [1, None, "a?b"],
    }
    assert figures(deep) == {"a": {"b": {"c": {"d": {"e": {"f": {}}}}}}}
    assert plain("\x1b[31m" + "x" * 1000) == "?[31m" + "x" * 395
