"""`eia-sec train` as a user meets it: interrupted, resumed, and without leaving anybody behind."""

import json
import os
import signal
import subprocess
import sys
import time

from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.deploy.local.local_runs import local_runs
from eia_sec.deploy.local.run_directory import METRICS
from eia_sec.deploy.reports.run_report import read_metrics
from tests.system.fleet import TINY, until
from tests.system.training import Training, gone

LONG = TINY.replace("episodes = 8", "episodes = 1000000")
OFTEN, RARE = "checkpoint_seconds = 0.5", "checkpoint_seconds = 3600.0"
WAITING = 40
"""More episodes than a learner's queue of 16 chunks and its slack of 400 steps can hold."""

LIFECYCLE = {
    "learner": ("is begun", "rollout 0 joined", "first update", "checkpoint-", "drain", "resumed"),
    "elite": ("leads", "ends"),
    "rollout-0": ("collects for run", "ends after"),
}
"""What each log of an interrupted and resumed run tells of."""


def test_interrupt_drains_and_resume_goes_on(training: Training) -> None:
    """Ctrl-C ends everybody with a checkpoint and code 0; the run goes on from there and does not count from zero."""
    training.config.write_text(LONG, encoding="utf-8")
    training.start("--no-report")
    until(lambda: training.episodes() >= 4, "training")
    children = training.children()
    assert training.process is not None
    training.process.send_signal(signal.SIGINT)
    assert training.wait(30.0) == 0, training.output.read_text()
    assert gone(children)
    before = training.episodes()
    assert "--resume" in training.output.read_text()
    training.start("--no-report", "--resume")
    until(lambda: training.episodes() > before + 2, "going on")
    lines = (training.run_dir / "metrics.jsonl").read_text().splitlines()
    counts = [record["episodes"] for record in map(json.loads, lines) if record["kind"] == "episodes"]
    assert counts == sorted(counts)
    training.process.send_signal(signal.SIGTERM)
    assert training.wait(30.0) == 0
    logs = {name: (training.run_dir / "logs" / f"{name}.log").read_text() for name in LIFECYCLE}
    assert {name: [words for words in LIFECYCLE[name] if words not in log] for name, log in logs.items()} == {
        name: [] for name in LIFECYCLE
    }, logs


def test_what_a_killed_learner_reported_is_reported_once(training: Training) -> None:
    """It begins again, as there was no checkpoint yet; who reads the records has each episode once."""
    assert RARE in LONG.replace(OFTEN, RARE)
    training.config.write_text(LONG.replace(OFTEN, RARE), encoding="utf-8")
    training.start("--no-report")
    until(lambda: training.episodes() >= 4, "training")
    next(child for child in training.children() if "learner" in child.cmdline()).kill()
    path = training.run_dir / METRICS

    def again() -> int:
        return sum(record["kind"] == "episodes" for record in read_metrics(path)) if resumed() else 0

    def resumed() -> bool:
        return '"kind": "resume"' in path.read_text(encoding="utf-8")

    until(lambda: again() >= 4, "going on")
    counts = [record["episodes"] for record in read_metrics(path) if record["kind"] == "episodes"]
    assert counts == sorted(set(counts))
    raw = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line.endswith("}")]
    assert len([record for record in raw if record["kind"] == "episodes"]) > len(counts)


def test_no_orphans_after_kill(training: Training) -> None:
    """When the supervisor itself is killed, its children end by themselves."""
    training.config.write_text(LONG, encoding="utf-8")
    training.start("--no-report")
    until(lambda: training.episodes() >= 1, "training")
    children = training.children()
    assert len(children) >= 3
    assert training.process is not None
    training.process.kill()
    training.process.wait(10.0)
    until(lambda: gone(children), "the end of the children", 30.0)


def test_a_worker_that_dies_is_started_again(training: Training) -> None:
    """The supervisor replaces a killed worker, says so, and the run goes on with the new one."""
    training.config.write_text(LONG, encoding="utf-8")
    training.start("--no-report")
    until(lambda: training.episodes() >= 2, "training")
    worker = next(child for child in training.children() if "rollout" in child.cmdline())
    os.kill(worker.pid, signal.SIGKILL)
    until(lambda: "rollout-0 ended with signal 9; restarting it" in training.output.read_text(), "the notice")
    before = training.episodes()
    until(lambda: training.episodes() > before + WAITING, "more than what waits at the learner")
    assert training.process is not None
    training.process.send_signal(signal.SIGTERM)
    assert training.wait() == 0, training.output.read_text()


def test_a_taken_endpoint_is_a_users_mistake(training: Training) -> None:
    """The address is named in one sentence and the exit code is 2."""
    endpoint = free_endpoint()
    with Bus.listen(endpoint, "control"):
        training.start("--endpoint", str(endpoint), "--no-report")
        assert training.wait(60.0) == 2
    assert f"cannot listen on {endpoint}" in training.output.read_text()


def test_a_run_directory_is_used_by_one_at_a_time(training: Training) -> None:
    """A second training in the same folder is refused with one sentence and code 2, and the first goes on."""
    training.config.write_text(LONG, encoding="utf-8")
    training.start("--no-report")
    until(lambda: training.episodes() >= 1, "training")
    first = training.process
    training.start("--no-report", "--resume")
    assert training.wait(30.0) == 2
    assert "in use" in training.output.read_text()
    training.process = first
    before = training.episodes()
    until(lambda: training.episodes() > before, "the first run going on")
    assert first is not None
    first.send_signal(signal.SIGTERM)
    assert first.wait(30.0) == 0
    time.sleep(0.1)


def test_a_monitor_finds_the_run_of_a_directory(training: Training) -> None:
    """The banner names the command, it shows the run, and afterwards the run is listed no more."""
    training.config.write_text(LONG, encoding="utf-8")
    training.start("--no-report")
    until(lambda: training.episodes() >= 1, "training")
    assert f"eia-sec monitor {training.run_dir}" in training.output.read_text()
    command = [sys.executable, "-m", "eia_sec.deploy.cli", "monitor", str(training.run_dir), "--json", "--seconds", "6"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=True)
    assert json.loads(done.stdout.splitlines()[-1])["state"] == "training"
    assert [run.run_dir for run in local_runs()] == [str(training.run_dir)]
    assert training.process is not None
    training.process.send_signal(signal.SIGTERM)
    assert training.wait(30.0) == 0
    assert local_runs() == []
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert done.stderr == f"eia-sec: no run is training in {training.run_dir}; none is training on this machine.\n"
