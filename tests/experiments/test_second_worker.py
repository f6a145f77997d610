"""The experiment with more and more workers: whom it starts, what it counts, and what its page makes of it."""

import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from common.errors import EiaSecError, UsageError
from common.transport.endpoint import free_endpoint
from deploy.local.supervisor import Child
from deploy.monitor.snapshot import LedgerCounts, ProcessRow
from docs.tools.measurements import second_worker_block
from experiments.network import second_worker
from experiments.network.second_worker import Arguments, WorkerPool, measure, memory, wait_for

SLOW = Arguments(workers=(1, 2, 4), seconds=10.0, settle=1.0)


class ASupervisor:
    """Starts processes that only sleep, and remembers what they were to be.

    Each is awaited: right behind exec a process has a page or two, which is 0.0 MiB.
    """

    def __init__(self) -> None:
        self.started: dict[str, Child] = {}

    def start(self, name, arguments):
        """Start one."""
        words = "import time; print('up', flush=True); time.sleep(600)"
        process = subprocess.Popen([sys.executable, "-c", words], stdout=subprocess.PIPE)
        assert process.stdout is not None
        assert process.stdout.readline() == b"up\n"
        self.started[name] = Child(name, arguments, 1, process=process)
        return self.started[name]


@pytest.fixture
def supervisor():
    """Yield a supervisor; whatever it has started ends."""
    made = ASupervisor()
    yield made
    for child in made.started.values():
        child.process.kill()
        child.process.communicate()


class AFleet:
    """A learner whose counters grow with the seconds that the test's clock has slept, faster with more workers."""

    def __init__(self, pool: WorkerPool) -> None:
        self.pool, self.values = pool, {"elapsed": 0.0, "environment_steps": 0, "updates": 0}
        self.accepted: dict[str, int] = {}

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        flown = seconds * 100.0 * len(self.pool.alive)
        self.values["elapsed"] += seconds
        self.values["environment_steps"] += flown
        self.values["updates"] += flown / 10.0
        for name in self.pool.alive:
            self.accepted[name] = self.accepted.get(name, -1) + 1
        self.values["ledger"] = dict.fromkeys(("produced", "accepted", "lost", "in_flight", "unexplained"), 7)

    def update(self) -> None:
        """Take nothing in."""

    def snapshot(self):
        """Return the state with a row for each worker that was ever seen, and one for the learner."""
        rows = [ProcessRow("rollout", n, "h", 1, 1, ledger=LedgerCounts(accepted=k)) for n, k in self.accepted.items()]
        return SimpleNamespace(processes=(ProcessRow("learner", "learner", "h", 1, 1.0), *rows))

    def learner_values(self):
        """Return the learner's metrics."""
        return dict(self.values)


class ABus:
    """Remembers what was asked."""

    def __init__(self) -> None:
        self.asked: list[str] = []

    def ask(self, key, payload, timeout):
        """Remember a key."""
        self.asked.append(key)


def test_each_number_of_workers_is_measured(supervisor, monkeypatch):
    """Rates and memory of 1, 2 and 4; the second is killed after its measurement, and nobody gets its name."""
    pool, bus = WorkerPool(supervisor, free_endpoint()), ABus()
    fleet, learner = AFleet(pool), supervisor.start("learner", [])
    monkeypatch.setattr(second_worker.time, "sleep", fleet.sleep)
    found = measure(SLOW, bus, fleet, pool, learner)
    assert [line["workers"] for line in found["sweep"]] == [1, 2, 4]
    assert [line["environment_steps_per_second"] for line in found["sweep"]] == pytest.approx([100.0, 200.0, 400.0])
    assert [line["updates_per_second"] for line in found["sweep"]] == pytest.approx([10.0, 20.0, 40.0])
    rates = {"one_worker": 100.0, "two_workers": 200.0, "after_kill": 100.0}
    assert found["environment_steps_per_second"] == pytest.approx(rates)
    assert found["gain"] == pytest.approx(2.0)
    assert list(pool.alive) == ["0", "2", "3", "4"]
    assert supervisor.started["rollout-1"].process.wait() == -signal.SIGKILL
    (key,) = bus.asked
    assert key.endswith("drain")
    text = second_worker_block({"command": "c", "commit": "d", **found})
    assert "| 4 | 400 | 40 |" in text
    assert f"on {os.cpu_count()} cores" in text


def test_memory_adds_up_over_processes(supervisor):
    """Two processes hold more than one; shared pages count in parts in PSS and whole in RSS."""
    if not Path("/proc/self/smaps_rollup").exists():
        pytest.skip("needs /proc/PID/smaps_rollup")
    first, second = (supervisor.start(name, []) for name in "ab")
    one, two = memory([first]), memory([first, second])
    assert 0.0 < one["pss_mib"] <= one["rss_mib"] < two["rss_mib"]
    second.process.kill()
    second.process.wait()
    with pytest.raises(EiaSecError, match="b has ended"):
        memory([second])


def test_a_worker_that_delivers_nothing_ends_it(supervisor, monkeypatch):
    """It is named, and nothing is measured."""
    pool = WorkerPool(supervisor, free_endpoint())
    pool.grow(1)
    monkeypatch.setattr(second_worker.time, "sleep", lambda _: None)
    with pytest.raises(EiaSecError, match="workers 0 in 0 s"):
        wait_for(AFleet(pool), pool, patience=0.0)


@pytest.mark.parametrize("wrong", [(1,), (2, 4), (1, 2, 2), (1, 2, 8, 4), (1, 4)])
def test_the_first_numbers_are_one_and_two(wrong):
    """The page and the capacity model need both, and numbers rise because workers are only added."""
    with pytest.raises(UsageError, match="begin with 1 2"):
        Arguments(workers=wrong).check()
    SLOW.check()


def test_a_learner_that_trains_is_written_elsewhere(tmp_path):
    """What the capacity model reads is the rate of workers that nobody holds back."""
    with pytest.raises(UsageError, match="another --output"):
        Arguments(updates_per_step=0.125).check()
    trains = Arguments(updates_per_step=0.125, output=tmp_path / "found.json")
    trains.check()
    assert trains.config().replay.updates_per_step == 0.125
    assert SLOW.config().replay.updates_per_step == 0.0
