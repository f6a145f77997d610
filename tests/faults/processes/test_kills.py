"""Kill -9, again and again: nothing unexplained, nothing twice, and everybody goes on."""

import json
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from tests.faults.tools.harness import BEHIND, LONG, FaultRun, Routed, memory, record_result, run, spread
from tests.system.fleet import until


def kill_workers(directory: Path, kills: int, workers: int, toml: str = LONG) -> dict[str, Any]:
    """Kill workers whose spools hold one chunk, in turn, and replace them; return the results."""
    with run(directory, toml.replace("chunk_steps = 10", "chunk_steps = 10\nspool_chunks = 1")) as fleet:
        fleet.learner()
        names = [str(index) for index in range(workers)]
        for name in names:
            fleet.worker(name)
        for name in names:
            until(lambda name=name: fleet.taken(name), f"chunks of worker {name}", 240.0)
        recovery, before = [], memory(fleet.running["learner"])
        for index in range(kills):
            name = names[index % workers]
            start = fleet.newest_incarnation(name)
            fleet.kill(f"rollout-{name}")
            started = time.monotonic()
            fleet.worker(name)
            until(
                lambda name=name, start=start: fleet.newest_incarnation(name) > start,
                f"chunks of the new worker {name}",
            )
            recovery.append(time.monotonic() - started)
        grown = memory(fleet.running["learner"]) - before
        fleet.end()
        found = fleet.audit()
        lost = found.to_dict()["lost_with"].get("worker", 0)
        return {
            "kills": kills,
            "workers": workers,
            "seconds_to_replace": spread(recovery),
            "lost_chunks": found.chunks["lost"],
            "lost_chunks_per_kill": round(found.chunks["lost"] / kills, 3),
            "lost_steps": lost,
            "learner_grew_mib": round(grown, 1),
            "unexplained": len(found.unexplained),
            "doubled": len(found.doubled),
        }


def check_workers(measured: dict[str, Any]) -> None:
    assert measured["unexplained"] == measured["doubled"] == 0
    assert measured["lost_chunks"] <= measured["kills"]


def test_killed_workers(tmp_path):
    """A killed worker whose spool stands full loses the one chunk that this holds, and its replacement delivers."""
    check_workers(kill_workers(tmp_path, kills=2, workers=2, toml=BEHIND))


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_killed_workers_at_full_dose(tmp_path):
    """Fifty kills among eight workers lose at most one chunk each, and nothing is counted twice."""
    measured = kill_workers(tmp_path, kills=50, workers=8)
    record_result("killed_workers", **measured)
    check_workers(measured)


def partial(fleet: FaultRun) -> bool:
    """Return whether a checkpoint is being written this moment."""
    return any((fleet.directory / "run" / "checkpoints").glob("partial-*"))


def kill_learner(directory: Path, kills: int, inside: int, interrupt: float = 20.0) -> dict[str, Any]:
    """Kill the learner, `inside` times while it writes a checkpoint; return the results."""
    quick = LONG.replace("checkpoint_seconds = 0.5", "checkpoint_seconds = 0.2")
    with run(directory, quick) as fleet:
        fleet.learner()
        fleet.worker()
        fleet.coordinator()
        until(fleet.taken, "chunks", 120.0)
        # A coordinator that has not joined yet would find nobody and give up.
        fleet.until_led("")
        recovery, hit = [], 0
        for index in range(kills):
            until(lambda: list((directory / "run" / "checkpoints").glob("checkpoint-*")), "a checkpoint")
            if index < inside:
                deadline = time.monotonic() + interrupt
                while time.monotonic() < deadline and not partial(fleet):
                    time.sleep(0.0005)
            fleet.kill("learner")
            hit += partial(fleet)
            started = time.monotonic()
            fleet.learner("--resume")
            fleet.until_more()
            recovery.append(time.monotonic() - started)
        until(lambda: fleet.status().get("ledger"), "a status")
        fleet.end()
        found = fleet.audit()
        ledger = fleet.status()["ledger"]
        return {
            "kills": kills,
            "inside_a_checkpoint_write": hit,
            "seconds_to_resume": spread(recovery),
            "lost_chunks": found.chunks["lost"],
            "lost_with_the_learner_steps": found.lost_with["learner"],
            "ledger_lost": ledger["lost"],
            "unexplained": len(found.unexplained) + ledger["unexplained"],
            "doubled": len(found.doubled),
        }


def check_learner(measured: dict[str, Any]) -> None:
    assert measured["unexplained"] == measured["doubled"] == 0
    # What the ledger declares is exactly what was acknowledged and not in a checkpoint.
    assert measured["ledger_lost"] == measured["lost_with_the_learner_steps"]


def test_killed_learner(tmp_path):
    """A killed learner resumes, its workers go on, and the ledger holds exactly what was lost with it."""
    check_learner(kill_learner(tmp_path, kills=1, inside=1))


@pytest.mark.nightly
@pytest.mark.timeout(3600)
def test_killed_learner_at_full_dose(tmp_path):
    """Twenty kills of the learner, five of them inside a checkpoint's write, and the ledger is exact."""
    measured = kill_learner(tmp_path, kills=20, inside=8)
    record_result("killed_learner", **measured)
    check_learner(measured)
    assert measured["inside_a_checkpoint_write"] >= 5


def kill_coordinator(directory: Path, kills: int) -> dict[str, Any]:
    """Kill the coordinator, and start it anew; return the results."""
    events = LONG.replace("cycle = 2", "cycle = 4\ncycle_growth = 1.0\nrate_decay = 0.9")
    with run(directory, events) as fleet:
        fleet.learner()
        fleet.worker()
        fleet.coordinator()
        until(lambda: fleet.status().get("event", 0) >= 1, "an imitation event", 120.0)
        recovery = []
        for _ in range(kills):
            fleet.kill("elite")
            started = time.monotonic()
            fleet.until_more()
            logged = fleet.log("elite")
            fleet.coordinator()
            fleet.until_led(logged)
            # What the one that was killed had delivered is in here, so the next event is of its successor.
            before = fleet.status()["event"]
            until(lambda before=before: fleet.status()["event"] > before, "an imitation event")
            recovery.append(time.monotonic() - started)
        fleet.end()
        numbers = [record["event"] for record in fleet.records("imitation")]
        found = fleet.audit()
        return {
            "kills": kills,
            "events": len(numbers),
            "in_order": numbers == list(range(1, len(numbers) + 1)),
            "seconds_to_next_event": spread(recovery),
            "unexplained": len(found.unexplained),
            "doubled": len(found.doubled),
        }


def test_killed_coordinator(tmp_path):
    """Training goes on without a coordinator, and the next one continues the schedule where it was."""
    measured = kill_coordinator(tmp_path, kills=1)
    assert measured["in_order"], json.dumps(measured)


@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_killed_coordinator_at_full_dose(tmp_path):
    """Twenty kills of the coordinator: every event comes once, in order."""
    measured = kill_coordinator(tmp_path, kills=20)
    record_result("killed_coordinator", **measured)
    assert measured["in_order"]
    assert measured["unexplained"] == 0


def kill_router(directory: Path, kills: int, outage: float) -> dict[str, Any]:
    """Kill the router through which all talk, and start another after a while; return the results."""
    with closing(Routed(directory)) as fleet:
        fleet.router()
        fleet.learner_at("run")
        fleet.worker()
        fleet.coordinator()
        until(lambda: fleet.status().get("event", 0) >= 1, "an imitation event", 120.0)
        recovery, worker = [], fleet.running["rollout-0"]
        before = memory(worker)
        for _ in range(kills):
            fleet.kill("router")
            time.sleep(outage)
            fleet.router()
            recovery.append(fleet.until_more())
        grown = memory(worker) - before
        event = fleet.status()["event"]
        until(lambda: fleet.status()["event"] > event, "an imitation event after the last kill")
        fleet.end()
        found = fleet.audit()
        return {
            "kills": kills,
            "outage_seconds": outage,
            "seconds_to_recover": spread(recovery),
            "worker_grew_mib": round(grown, 1),
            "lost_chunks": found.chunks["lost"],
            "unexplained": len(found.unexplained),
            "doubled": len(found.doubled),
        }


def check_router(measured: dict[str, Any]) -> None:
    assert measured["unexplained"] == measured["doubled"] == measured["lost_chunks"] == 0
    assert measured["worker_grew_mib"] <= 64


def test_killed_router(tmp_path):
    """While there is no router everybody waits, and goes on with the next one; nothing is lost."""
    check_router(kill_router(tmp_path, kills=1, outage=0.5))


@pytest.mark.nightly
@pytest.mark.timeout(1800)
def test_killed_router_at_full_dose(tmp_path):
    """Twenty kills of the router with outages of five seconds lose nothing."""
    measured = kill_router(tmp_path, kills=20, outage=5.0)
    record_result("killed_router", **measured)
    check_router(measured)
