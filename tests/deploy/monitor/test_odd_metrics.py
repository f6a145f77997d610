"""Odd or hostile metrics of other processes: the view counts them and goes on."""

import io
import json
import time
from types import SimpleNamespace

import pytest
from rich.console import Console

from eia_sec.common.errors import SchemaError
from eia_sec.common.process import Presence
from eia_sec.common.protocol.messages import Envelope, MetricMessage
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.deploy.commands.monitoring.monitor import record
from eia_sec.deploy.monitor import live_view, process_report, run_monitor
from eia_sec.deploy.monitor.live_view import render, summary
from eia_sec.deploy.monitor.run_monitor import RunMonitor
from eia_sec.deploy.monitor.sanitised import MOST_PARTS, metrics, plain
from eia_sec.deploy.monitor.snapshot import Series

SOUND = {
    "state": "training",
    "episodes": 10,
    "episodes_total": 72,
    "elapsed": 5.0,
    "environment_steps": 100,
    "curves": {"reward": {"mean": 1.0}, "steps": 5.0},
}


@pytest.fixture
def monitor():
    """A view of a run in which nobody lives yet."""
    with Bus.listen(free_endpoint(), "control") as bus:
        yield RunMonitor(bus, "r")


def report(monitor, role, values, name="x", counter=1):
    """Report metrics as a process, as if the message had just arrived; return whether the view accepted it."""
    try:
        message = MetricMessage(counter, "host", 1, float(counter), values)
        monitor._take((role, name), Envelope(role, name, 1, counter, 1), message, time.monotonic())
    except run_monitor.UNREADABLE:
        return False
    return True


def drawn(monitor):
    """Return the view at the width that shows every column, its one line, and its JSON, none of which may fail."""
    snapshot = monitor.snapshot()
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
def test_malformed_metrics_affect_only_their_sender(monitor, odd, role):
    """Such a message counts as unreadable, and whatever else is known is shown."""
    assert report(monitor, "learner", {**SOUND, "alarms": ["no checkpoint"]}, "learner")
    assert not report(monitor, role, odd)
    shown = drawn(monitor)
    assert "10 of 72 episodes" in shown
    assert "no checkpoint" in shown


def test_what_is_kept_of_a_process_is_small(monitor):
    """Of earlier reports only counters are kept, and of many alarms the first are shown and the others counted."""
    for counter in range(1, 100):
        assert report(
            monitor, "rollout", {"environment_steps": counter, "alarms": ["a"] * 30, "x": [0] * 1000}, counter=counter
        )
    seen = monitor._reports["rollout", "x"]
    assert seen.message.values == {}
    assert {name for _, kept in seen._track for name in kept} == set(process_report.COUNTERS)
    assert monitor.snapshot().processes[0].rate == 1.0
    assert [text for text in monitor.snapshot().alarms if text.startswith("rollout x")] == [
        *["rollout x: a"] * process_report.MOST_ALARMS,
        f"rollout x: {30 - process_report.MOST_ALARMS} more alarms.",
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
def test_odd_metrics_of_the_learner_end_no_view(monitor, odd):
    """They are left out or make the view do without this message; nothing is obeyed as markup or by the terminal."""
    report(monitor, "learner", SOUND | odd, "learner")
    assert "\x1b" not in drawn(monitor)
    report(monitor, "learner", SOUND, "learner", counter=2)
    assert "10 of 72 episodes" in drawn(monitor)


def test_rows_and_curves_are_bounded(monitor, monkeypatch):
    """Names without end take no memory without end: further ones are turned away, and there is room for the learner."""
    monkeypatch.setattr(run_monitor, "MOST_ROWS", 3)
    monkeypatch.setattr(run_monitor, "MOST_CURVES", 2)
    assert [report(monitor, "rollout", {}, str(index)) for index in range(5)] == [True] * 3 + [False] * 2
    assert not report(monitor, "learner", SOUND, "other")
    assert report(monitor, "learner", SOUND, "learner")
    assert [report(monitor, "elite", {}, str(index)) for index in range(6)] == [True] * 4 + [False] * 2
    assert "10 of 72 episodes" in drawn(monitor)
    many = {"curves": {"reward": {str(index): 1.0 for index in range(9)}}}
    monitor._reports.clear()
    assert not report(monitor, "learner", many, "learner")
    assert len(monitor.snapshot().reward) == 2


def test_rows_that_only_the_learner_knows_are_bounded(monitor, monkeypatch):
    """However many workers a ledger names, a view has MOST_ROWS rows and says how many are missing."""
    monkeypatch.setattr(run_monitor, "MOST_ROWS", 3)
    report(monitor, "learner", {**SOUND, "ledgers": {f"w{index}": {} for index in range(9)}}, "learner")
    snapshot = monitor.snapshot()
    assert len(snapshot.processes) == 3
    assert "7 workers that have left are not shown: a view has 3 rows." in snapshot.alarms


def test_processes_without_end_are_counted(monkeypatch):
    """Tokens and metrics of ever new names over the bus leave MOST_ROWS rows and a count of what was dropped."""
    monkeypatch.setattr(run_monitor, "MOST_ROWS", 8)
    endpoint = free_endpoint()
    with Bus.listen(endpoint, "control") as bus, Bus.connect(endpoint, "control") as stranger:
        monitor = RunMonitor(bus, "r")
        found = [Presence(stranger, "r", "rollout", f"w{index}", 1) for index in range(40)]
        deadline = time.monotonic() + 30.0
        while not any("32 messages of further processes" in text for text in monitor.snapshot().alarms):
            assert time.monotonic() < deadline, monitor.snapshot().alarms
            time.sleep(0.05)
            monitor.update()
        deadline = time.monotonic() + 30.0
        while sum(bool(held.values) for held in monitor._reports.values()) < 8:
            assert time.monotonic() < deadline
            for presence in found:  # again and again: reports are lossy
                presence.report({"alarms": ["a" * 1000] * 50, "x": ["y" * 400] * 50})
            time.sleep(0.05)
            monitor.update()
        assert len(monitor.snapshot().processes) == 8
        kept = [len(json.dumps(held.values)) for held in monitor._reports.values()]
        assert max(kept) < 8000
        assert len(monitor.snapshot().alarms) <= run_monitor.MOST_ALARMS + 8


def test_a_process_without_a_token_goes_when_it_has_long_been_silent(monitor, monkeypatch):
    """Metrics alone make a row, for as long as they come."""
    report(monitor, "rollout", {})
    monitor.update()
    assert len(monitor.snapshot().processes) == 1
    monkeypatch.setattr(run_monitor, "GONE_SECONDS", 0.0)
    monitor.update()
    assert monitor.snapshot().processes == ()


def test_what_is_left_of_metrics():
    """Numbers that are finite and no larger than any of ours, texts that print, maps and lists; of bytes nothing."""
    deep = {"a": {"b": {"c": {"d": {"e": {"f": {"g": {"h": 1}}}}}}}}
    values = {"x": 1, "y": 2.5, "on": True, "nan": float("nan"), "big": 10**16, "bytes": b"x", "none": None}
    assert metrics({**values, "list": [1, float("inf"), "a\nb"]}) == {
        **{"x": 1, "y": 2.5, "on": True},
        "list": [1, None, "a?b"],
    }
    assert metrics(deep) == {"a": {"b": {"c": {"d": {"e": {"f": {}}}}}}}
    assert plain("\x1b[31m" + "x" * 1000) == "?[31m" + "x" * 395


def test_deep_nesting_is_refused(monitor):
    """A report that is nested a thousand times is counted; the view goes on."""
    deep = 0.0
    for _ in range(900):
        deep = [deep]
    with pytest.raises(SchemaError, match="levels"):
        metrics({"a": deep})


def test_labels_are_shown_as_they_are():
    """What looks like markup in the label of a metric is a part of the label."""
    series = Series("delay [ms]", (1.0, 2.0), 1)
    odd = Series("[/x]", (1.0,), 1)
    console = Console(file=io.StringIO(), width=100)
    console.print(
        live_view._learning(SimpleNamespace(reward=(), noise_free=Series("without noise"), freshness=(series, odd)))
    )
    shown = console.file.getvalue()
    assert "delay [ms]" in shown
    assert "[/x]" in shown


def test_a_view_that_began_after_the_learner_died_says_so(monitor):
    """Workers that hold parameters had a learner: the run is not starting. Without parameters it is."""
    report(monitor, "rollout", {"environment_steps": 5})
    snapshot = monitor.snapshot()
    assert snapshot.state == "without learner"
    assert "no learner is there, and workers hold the parameters of one." in snapshot.alarms
    monitor._reports[("rollout", "x")].version = 0
    assert (monitor.snapshot().state, monitor.snapshot().alarms) == ("starting", ())


@pytest.mark.parametrize(("waited", "alarmed"), [(0.95, False), (0.1, True)])
def test_workers_that_the_learner_holds_back_are_in_no_trouble(monitor, waited, alarmed):
    """No step in ten seconds is backpressure while a worker waits for the learner, else an alarm."""
    report(monitor, "learner", SOUND, "learner")
    for second in range(20, 33):
        report(monitor, "rollout", {"environment_steps": 500, "waiting_seconds": waited * second}, counter=second)
    assert ("rollout x produces no steps." in monitor.snapshot().alarms) is alarmed
