"""A population on one machine: rounds are held, each role may be killed, and every member's account stays exact."""

import json
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import psutil
import pytest

from eia_sec.common.config.files import read_saved
from eia_sec.deploy.monitor.audit import audit
from eia_sec.deploy.reports.lineage import exploits
from eia_sec.deploy.reports.run_report import read_metrics
from tests.system.fleet import on_policy, until
from tests.system.training import Training, gone

MEMBERS = ("member-0", "member-1")
TABLE = """
[population]
farms = 2
interval = {interval}
[population.hyperparameters]
actor_rate = [1e-4, 1e-2]
entropy_start = [1e-3, 1e-1]
"""


def configured(episodes: int, interval: float) -> str:
    """Return a run of so many episodes, whose rounds are due at multiples of a share."""
    return on_policy("ippo").replace("episodes = 8", f"episodes = {episodes}") + TABLE.format(interval=interval)


class PopulationRun(Training):
    """One `eia-sec train --population 2` with its members."""

    def member(self, name: str) -> Path:
        """Return a member's run directory."""
        return self.run_dir / "members" / name

    def records(self, name: str, kind: str) -> list[dict[str, Any]]:
        """Return a member's records of one kind."""
        path = self.member(name) / "metrics.jsonl"
        lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
        return [record for line in lines if line.endswith("}") and (record := json.loads(line))["kind"] == kind]

    def rounds(self) -> int:
        """Return the newest round that a member took part in."""
        return max((event["round"] for name in MEMBERS for event in self.records(name, "exploit")), default=0)

    def child(self, *words: str) -> psutil.Process:
        """Return the child whose command line has all these words."""

        def found() -> psutil.Process | None:
            for child in self.children():
                try:
                    line = child.cmdline()
                except psutil.NoSuchProcess:
                    continue
                if all(word in line for word in words):
                    return child
            return None

        process: psutil.Process = until(found, " ".join(words), 60.0)
        return process


@contextmanager
def running(run: PopulationRun) -> Iterator[PopulationRun]:
    """Leave nothing of a population behind, whatever becomes of the test."""
    try:
        yield run
    finally:
        _end(run)


def _end(run: PopulationRun) -> None:
    if run.process is not None and run.process.poll() is None:
        for child in run.children():
            child.kill()
        run.process.kill()
        run.process.wait(10.0)


def stop(population: PopulationRun) -> None:
    """Stop it by Ctrl-C; its learners write checkpoints, and no process is left."""
    assert population.process is not None
    children = population.children()
    population.process.send_signal(signal.SIGINT)
    assert population.wait(90.0) == 0
    assert gone(children)
    assert "resume with: eia-sec train" in population.output.read_text()


def check_accounts(population: PopulationRun) -> None:
    """Every step of every member is accounted for, and each round begins with what the one before it left."""
    for name in MEMBERS:
        found = audit(population.member(name))
        assert (len(found.unexplained), len(found.doubled)) == (0, 0)
        assert population.records(name, "status")[-1]["ledger"]["unexplained"] == 0
        rounds = exploits(read_metrics(population.member(name) / "metrics.jsonl"))
        assert all(later["before"] == earlier["hyperparameters"] for earlier, later in pairwise(rounds))


@pytest.mark.slow
@pytest.mark.timeout(1500)
def test_a_population_survives_a_kill_of_each_role(tmp_path):
    """Coordinator, worker and learner are killed once, and rounds go on; so they do after a stop and a resume.

    Each member's account stays exact, and its hyperparameters outlive the learner that took them over.
    """
    with running(PopulationRun(tmp_path, configured(20_000, 0.001))) as population:
        population.start("--population", "2")
        until(lambda: population.rounds() >= 1, "a round", 300.0)
        population.child("elite").kill()
        before = population.rounds()
        until(lambda: population.rounds() > before, "a round of the next coordinator", 300.0)

        population.child("rollout", "member-0").kill()
        population.child("learner", "member-1").kill()
        taken = population.rounds()
        resume = until(lambda: population.records("member-1", "resume"), "member-1 to resume", 120.0)[0]
        assert resume["environment_steps"] > 0

        def later() -> dict[str, Any] | None:
            events = population.records("member-1", "exploit")
            return events[-1] if events and events[-1]["round"] > taken else None

        event = until(later, "a round with both", 300.0)
        assert set(event["scores"]) == set(MEMBERS)
        stop(population)
        check_accounts(population)

        before = population.rounds()
        population.start("--population", "2", "--resume")
        until(lambda: population.rounds() > before, "a round after the resume", 300.0)
        stop(population)
        check_accounts(population)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_a_population_ends_with_its_best(tmp_path):
    """Its policy is that of the run directory; the history says who imitated whom, and the picture shows it."""
    with running(PopulationRun(tmp_path, configured(60, 0.2))) as population:
        population.start("--population", "2", "--no-report")
        assert population.wait(600.0) == 0
        (best,) = re.findall(r"the best is (member-\d)", population.output.read_text())
        policy = (population.run_dir / "policy.safetensors").read_bytes()
        assert policy == (population.member(best) / "policy.safetensors").read_bytes()
        assert (population.run_dir / "lineage.png").stat().st_size > 10_000
        check_accounts(population)
        configs = [read_saved(population.member(name) / "config.toml") for name in MEMBERS]
        for name, config in zip(MEMBERS, configs, strict=True):
            assert population.records(name, "end")[-1]["state"] == "finished"
            for event in population.records(name, "exploit"):
                for option, (low, high) in config.population.hyperparameters.items():
                    assert low <= event["hyperparameters"][option] <= high
        imitated = [event for name in MEMBERS for event in population.records(name, "exploit") if event["sources"]]
        assert imitated
        assert all(event["rate"] == 1.0 and set(event["sources"].values()) <= set(MEMBERS) for event in imitated)
        one, other = configs
        assert (one.seed != other.seed, one.network_seed == other.network_seed) == (True, True)
        assert one.algorithm.actor_rate != other.algorithm.actor_rate
