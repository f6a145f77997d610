"""Processes that stand still: the learner for seconds, a learner that is replaced meanwhile, a coordinator likewise."""

import itertools
import json
import shutil
import signal
import time
from pathlib import Path
from typing import Any

import pytest

from eia_sec.deploy.monitor.audit import audit
from tests.faults.tools.harness import BEHIND, LONG, Routed, memory, record_result, run
from tests.system.fleet import until

EVENTS = LONG.replace("cycle = 2", "cycle = 4\ncycle_growth = 1.0\nrate_decay = 0.9")


def freeze_learner(directory: Path, seconds: list[float]) -> dict[str, Any]:
    """Freeze the learner for each time; return how the worker fared."""
    with run(directory) as fleet:
        learner, worker = fleet.learner(), fleet.worker()
        until(fleet.taken, "chunks", 120.0)
        rows = []
        for span in seconds:
            before = memory(worker)
            learner.send_signal(signal.SIGSTOP)
            time.sleep(span)
            grown = memory(worker) - before
            learner.send_signal(signal.SIGCONT)
            recovery = fleet.until_more(seconds=60.0)
            rows.append({"seconds": span, "worker_grew_mib": round(grown, 1), "seconds_to_recover": round(recovery, 2)})
        fleet.end()
        found = fleet.audit()
        return {"freezes": rows, "lost_chunks": found.chunks["lost"], "unexplained": len(found.unexplained)}


def check_freezes(measured: dict[str, Any]) -> None:
    assert all(row["worker_grew_mib"] <= 64 for row in measured["freezes"])
    assert measured["unexplained"] == 0


def test_a_frozen_learner(tmp_path):
    """While the learner stands still a worker waits in bounded memory, and goes on by itself afterwards."""
    check_freezes(freeze_learner(tmp_path, [1.0]))


@pytest.mark.nightly
@pytest.mark.timeout(900)
def test_a_frozen_learner_at_full_dose(tmp_path):
    """Frozen for 3, 9 and 60 seconds: memory bounded, recovery within 10 seconds."""
    measured = freeze_learner(tmp_path, [3.0, 9.0, 60.0])
    record_result("frozen_learner", **measured)
    check_freezes(measured)
    assert all(row["seconds_to_recover"] <= 10 for row in measured["freezes"])


def epochs_of(directory: Path) -> list[int]:
    """Return the epochs of the learner's starts, by its history."""
    lines = (directory / "history" / "learner.jsonl").read_text(encoding="utf-8").splitlines()
    return [json.loads(line)[3] for line in lines if line.startswith('["start"')]


def replace_a_frozen_learner(directory: Path, seconds: float) -> dict[str, Any]:
    """Freeze a learner, let another take its place, thaw it; return the results."""
    fleet = Routed(directory, BEHIND)
    try:
        fleet.router()
        old = fleet.learner_at("run")
        fleet.worker()
        until(fleet.taken, "chunks", 120.0)
        until(lambda: fleet.status().get("queue"), "a full queue")
        until(lambda: list((directory / "run" / "checkpoints").glob("checkpoint-*")), "a checkpoint")
        old.send_signal(signal.SIGSTOP)
        shutil.copytree(directory / "run", directory / "second", ignore=shutil.ignore_patterns("*.lock"))
        fleet.learner_at("second", "--resume")
        history = directory / "second" / "history" / "learner.jsonl"
        until(lambda: history.read_text().count('["start"') >= 2, "the second learner")
        lines = len(history.read_text().splitlines())
        until(lambda: len(history.read_text().splitlines()) > lines + 5, "chunks for the second learner")
        with fleet.metrics("rollout", "0") as heard:
            until(heard, "a report of the worker")
            old.send_signal(signal.SIGCONT)
            code = fleet.wait("learner-run", 90.0)
            reports = len(heard())
            until(lambda: len(heard()) > reports + 1, "reports after the thaw")
            time.sleep(seconds)
            epochs = [report["epoch"] for report in heard()]
        fleet.running.pop("learner-run")
        second = fleet.running["learner-second"]
        second.send_signal(signal.SIGTERM)
        assert fleet.wait("learner-second", 60.0) == 0
        fleet.running["rollout-0"].send_signal(signal.SIGTERM)
        assert fleet.wait("rollout-0", 60.0) == 0
        shutil.copy(directory / "run" / "history" / "rollout-0.jsonl", directory / "second" / "history")
        found = audit(directory / "second")
        return {
            "old_learner_exit_code": code,
            "old_learner_said": _last_words(fleet.log("learner-run")),
            "falls_of_the_epoch": sum(after < before for before, after in itertools.pairwise(epochs)),
            "worker_ends_with_the_new_epoch": epochs[-1] == epochs_of(directory / "second")[-1],
            "lost_chunks": found.chunks["lost"],
            "unexplained": len(found.unexplained),
            "doubled": len(found.doubled),
        }
    finally:
        fleet.close()


def _last_words(log: str) -> str:
    """Return the sentence that a process ended with; a checkpoint's thread may log a line after it."""
    return next((line for line in log.splitlines() if line.startswith("eia-sec: ")), log)


def test_a_learner_that_was_frozen_and_replaced(tmp_path):
    """A thawed learner whose place is taken ends by itself, also with a full queue; all chunks are accounted for."""
    measured = replace_a_frozen_learner(tmp_path, 0.5)
    record_result("replaced_learner", **measured)
    assert measured["old_learner_exit_code"] == 2
    assert "newer learner" in measured["old_learner_said"]
    assert measured["falls_of_the_epoch"] == 0
    assert measured["worker_ends_with_the_new_epoch"]
    assert measured["unexplained"] == measured["doubled"] == 0


def test_of_two_coordinators_one_leads(tmp_path):
    """The second one stands by; when the first is frozen it takes over, and every event comes once."""
    with run(tmp_path, EVENTS) as fleet:
        fleet.learner()
        fleet.worker()
        first = fleet.coordinator("elite")
        until(lambda: "leads" in fleet.log("elite"), "a leading coordinator", 120.0)
        fleet.coordinator("second")
        until(lambda: fleet.status().get("event", 0) >= 1, "an imitation event", 120.0)
        first.send_signal(signal.SIGSTOP)
        until(lambda: "leads" in fleet.log("second"), "the second coordinator's lead", 60.0)
        before = fleet.status()["event"]
        until(lambda: fleet.status()["event"] > before, "an event of the second coordinator")
        first.send_signal(signal.SIGCONT)
        until(lambda: "stands by" in fleet.log("elite"), "the first coordinator to stand by", 30.0)
        before = fleet.status()["event"]
        until(lambda: fleet.status()["event"] > before, "another event")
        fleet.end()
        numbers = [record["event"] for record in fleet.records("imitation")]
        assert numbers == list(range(1, len(numbers) + 1))
