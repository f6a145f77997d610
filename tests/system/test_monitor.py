"""Watching a real run: the monitor's lines, a plain subscriber, and that every metric is declared."""

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import MetricMessage
from eia_sec.common.protocol.metrics import METRICS, undeclared
from eia_sec.common.transport.bus import Bus
from eia_sec.deploy.exit_codes import PIPE_CLOSED
from eia_sec.deploy.monitor.snapshot import Snapshot, record
from tests.faults.tools.harness import LONG
from tests.system.fleet import RUN, Processes, until

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 90.0

OF_POPULATIONS = {"exploits", "hyperparameters", "round", "rounds_refused"}


@pytest.fixture(scope="module")
def watched(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Processes]:
    """A run of a learner, a coordinator and two workers, in which an imitation event has been applied."""
    fleet = Processes(tmp_path_factory.mktemp("watched"), LONG)
    try:
        fleet.learner()
        fleet.coordinator()
        fleet.worker("0")
        fleet.worker("1")
        until(lambda: fleet.records("imitation"), "an imitation event")
        yield fleet
    finally:
        fleet.close()


def monitor(watched: Processes, *extra: str) -> subprocess.Popen[str]:
    arguments = ["monitor", "--run", RUN, "--connect", str(watched.endpoint), "--json", "--refresh", "0.2", *extra]
    return subprocess.Popen(
        [sys.executable, "-m", "eia_sec.deploy.cli", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def line(process: subprocess.Popen[str]) -> dict[str, Any]:
    assert process.stdout is not None
    return dict(json.loads(process.stdout.readline()))


def test_the_monitor_shows_fleet_ledger_curves_and_imitation(watched: Processes) -> None:
    """Its lines have every field; ledgers of both workers add up to the run's; Ctrl-C ends it with code 0."""
    with monitor(watched) as process:
        try:
            now = until(lambda: settled(line(process)), "a line with everything")
            assert set(now) == set(record(Snapshot("x")))
            rows = {(row["role"], row["name"]): row for row in now["processes"]}
            assert set(rows) == {
                ("learner", "learner"),
                ("elite", "coordinator"),
                ("rollout", "0"),
                ("rollout", "1"),
            }
            assert all(row["host"] != "-" and row["pid"] and row["uptime"] > 0 for row in rows.values())
            total = now["ledger"]
            known = total["accepted"] + total["lost"] + total["rejected"] + total["in_flight"]
            assert total["produced"] == known > 0
            event = now["imitation"]["newest"][-1]
            assert 0 < event["rate"] < 1
            assert [elite[0] for elite in event["elites"]] == ["c", "m", "d"]
            assert [series["name"] for series in now["reward"]] == ["mean", "communication", "monitoring", "collection"]
            process.send_signal(signal.SIGINT)
            assert process.wait(SECONDS) == 0
        finally:
            process.kill()


def settled(now: dict[str, Any]) -> dict[str, Any] | None:
    """Return a line that has heard of everybody and of an event, and whose ledgers add up."""
    rows = now["processes"]
    known = len(rows) == 4 and all(row["pid"] for row in rows) and now["reward"] and now["imitation"]["newest"]
    parts = [row["ledger"] for row in rows if row["role"] == "rollout"]
    return now if known and all(parts) and adds_up(parts, now["ledger"]) else None


def adds_up(parts: list[dict[str, Any]], total: dict[str, Any]) -> bool:
    """Return whether workers' ledgers add up; before the learner lists a worker, its own counts are shown."""
    names = ("produced", "accepted", "lost", "rejected", "in_flight")
    return all(sum(part[name] or 0 for part in parts) == total[name] for name in names)


def test_the_monitor_ends_when_its_reader_goes(watched: Processes) -> None:
    """A closed pipe ends it with code 141 and without a traceback."""
    with monitor(watched) as process:
        try:
            assert line(process)["run"] == RUN
            assert process.stdout is not None
            assert process.stderr is not None
            process.stdout.close()
            assert process.wait(SECONDS) == PIPE_CLOSED
            assert process.stderr.read() == ""
        finally:
            process.kill()


def test_every_figure_of_a_run_is_declared(watched: Processes) -> None:
    """What each role reports is declared in `eia_sec.common.protocol.metrics`, and the reverse.

    Only members of a population and their coordinator report what is of populations.
    """
    reports: dict[str, MetricMessage] = {}
    with Bus.connect(watched.endpoint, "control", wait=10.0) as bus:
        subscription = bus.subscribe(keys.METRIC.pattern(RUN), 256)

        def everybody() -> bool:
            for sample in subscription.drain():
                reports[keys.parse(sample.key).variables["role"]] = MetricMessage.decode(sample.payload)
            return set(reports) == {"learner", "rollout", "elite"}

        until(everybody, "a message of each role")
    for role, message in reports.items():
        assert undeclared(role, message.values) == []
        missing = {metric.name.split("/")[0] for metric in METRICS[role]} - set(message.values)
        assert missing <= OF_POPULATIONS


def test_the_plain_subscriber_on_the_page_works(watched: Processes) -> None:
    """The example of docs/reference/monitoring.md prints the metrics of all roles, without anything of this project."""
    example = ROOT / "docs" / "examples" / "subscriber.py"
    command = [sys.executable, "-P", str(example), str(watched.endpoint)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd="/", env={}) as process:
        try:
            assert process.stdout is not None
            roles: set[str] = set()
            while roles != {"learner", "rollout", "elite"}:
                key, _, fields = process.stdout.readline().partition(" ")
                assert "'uptime': " in fields
                assert "'values': {" in fields
                roles.add(keys.parse(key).variables["role"])
        finally:
            process.kill()
    code = [text for text in example.read_text(encoding="utf-8").splitlines() if text]
    assert len(code) <= 10
    assert not any(package in " ".join(code) for package in ("common", "deploy"))
