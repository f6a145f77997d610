"""The benchmark of distribution: its clock, its paced environment, what it counts, and what its page makes of it."""

import json
import os
import subprocess
import sys
from types import SimpleNamespace

import pytest

from eia_sec.common.config import RunConfig
from eia_sec.common.errors import EiaSecError
from eia_sec.common.protocol.messages import MetricMessage
from eia_sec.rollout.worker.collector import Collector
from research.benchmarks.distribution import __main__ as command
from research.benchmarks.distribution.farm import rates
from research.benchmarks.distribution.paced import PacedEnv, Pacer, parallel_env
from research.benchmarks.distribution.processes import Processes, busy
from research.benchmarks.distribution.records import MovingReward, Tail, between
from research.benchmarks.distribution.summary import summary
from research.benchmarks.distribution.training import WINDOW, Task, Watch, WorkerTimes, result, train
from research.benchmarks.peers.catalogue import ROOT


class Clock:
    """Seconds that pass only when somebody sleeps or works."""

    def __init__(self):
        self.now = 100.0

    def read(self):
        """Return the time."""
        return self.now

    def pass_by(self, seconds):
        """Let time pass."""
        self.now += seconds


def test_a_step_lasts_its_period_and_lost_time_stays_lost():
    """What is done within the period costs nothing; after a delay a whole period follows, not a shorter one."""
    clock = Clock()
    pacer = Pacer(0.02, clock.read, clock.pass_by)
    ends = []
    for work in (0.0, 0.015, 0.019, 0.05, 0.0):
        clock.pass_by(work)
        pacer.wait()
        ends.append(round(clock.now - 100.0, 6))
    assert ends == [0.02, 0.04, 0.06, 0.11, 0.13]


def test_the_paced_environment_is_the_task_itself():
    """Only the time of a step differs; the reset takes none."""
    clock = Clock()
    paced, plain = parallel_env(0.02), parallel_env(0.0)
    assert isinstance(paced, PacedEnv)
    paced._pacer = Pacer(0.02, clock.read, clock.pass_by)
    seen = [env.reset(seed=3)[0] for env in (paced, plain)]
    assert {name: part.tolist() for name, part in seen[0].items()} == {
        name: part.tolist() for name, part in seen[1].items()
    }
    for _ in range(3):
        steps = [env.step(dict.fromkeys(env.agents, 1)) for env in (paced, plain)]
        assert steps[0][1] == steps[1][1]
    assert clock.now == pytest.approx(100.06)


def test_a_worker_flies_the_task():
    """The configuration is whole: a chunk has a step of its one environment for each of `chunk_steps`."""
    config = Task(period=0.0, chunk_steps=5).config(seed=4)
    collector = Collector(config, "0", 0)
    assert (config.seed, collector.team.agents, len(collector.environments.time)) == (4, 4, 1)
    assert config.on_policy.objective == "decoupled"
    assert config.learner.threads == config.rollout.threads == 1


def test_only_new_whole_lines_are_read(tmp_path):
    """A line that is being written is left for the next look; before there is a file there is nothing."""
    path = tmp_path / "metrics.jsonl"
    tail = Tail(path)
    assert list(tail.new()) == []
    path.write_text('{"kind": "a"}\n{"kind": ')
    assert [record["kind"] for record in tail.new()] == ["a"]
    assert list(tail.new()) == []
    with path.open("a") as file:
        file.write('"b"}\n')
    assert [record["kind"] for record in tail.new()] == ["b"]


def episodes(count, reward, steps=0):
    """Return a record of finished episodes."""
    return {"kind": "episodes", "episodes": count, "environment_steps": steps, "reward": {"mean": reward}}


def test_the_reward_is_that_of_the_newest_episodes():
    """A record counts as often as it has episodes; there is no mean before the window is full."""
    reward = MovingReward(3)
    assert reward.add(episodes(1, 0.0)) is None
    assert reward.add(episodes(3, 6.0)) == pytest.approx(4.0)
    assert reward.add(episodes(4, 0.0)) == pytest.approx(4.0)
    assert reward.add(episodes(7, 9.0)) == pytest.approx(9.0)


def test_the_clock_starts_with_the_first_chunk_and_stops_at_the_reward():
    """The chunk that is accepted first was begun before; records after the reward change nothing."""
    task = Task(reward=-10.0, period=0.02, chunk_steps=25, limit=60.0)
    watch = Watch(task)
    watch.add([{"kind": "status", "environment_steps": 0}], now=90.0)
    assert not watch.over(1000.0)
    watch.accepted(0, now=95.0)
    watch.accepted(25, now=100.0)
    watch.accepted(50, now=101.0)
    assert watch.first == pytest.approx(99.5)
    watch.add([episodes(WINDOW - 1, -20.0, 2475), episodes(WINDOW, -20.0, 2500)], now=110.0)
    assert (watch.reached, watch.over(110.0)) == (None, False)
    watch.add([episodes(2 * WINDOW, -10.0, 5000), episodes(2 * WINDOW + 1, -5.0, 5025)], now=130.0)
    assert (watch.reached, watch.steps) == (130.0, 5000)
    assert watch.over(130.0)
    assert watch.curve == [(10.5, 2500, -20.0), (30.5, 5000, -10.0)]


def test_a_run_that_learns_nothing_ends():
    """At the limit the clock stops, and the run has not reached the reward."""
    watch = Watch(Task(limit=60.0, chunk_steps=1, period=1.0))
    watch.accepted(1, now=11.0)
    assert [watch.over(now) for now in (70.0, 70.1)] == [False, True]
    assert watch.reached is None


def a_status(**changed):
    """Return a report of the learner."""
    return {
        "kind": "status",
        "time": 0.0,
        "environment_steps": 0,
        "updates": 80,
        "waits": {"training": 2.0},
        "ledger": {"unexplained": 0, "rejected": 25, "produced": 2500},
        "statistics": {"iterations": 2.0},
        **changed,
    }


def test_a_run_is_summed_up():
    """Rates are by the time to the reward, updates' times by their number; unexplained steps are an error."""
    watch = Watch(Task(reward=-10.0, period=0.0))
    watch.accepted(25, now=100.0)
    watch.add([episodes(WINDOW, -9.0, 2500), a_status()], now=110.0)
    workers = WorkerTimes()
    workers._newest = {name: {"waiting_seconds": 1.0, "simulating_seconds": 4.0} for name in "ab"}
    found = result(watch, workers, started=80.0, ended=110.0)
    assert (found["reached"], found["seconds"], found["seconds_from_launch"]) == (True, 10.0, 30.0)
    assert (found["steps_per_second"], found["update_ms"], found["learner_updating"]) == (250.0, 25.0, 0.2)
    assert (found["workers_waiting"], found["rejected_share"], found["iterations"]) == (0.2, 0.01, 2)
    watch.last = a_status(ledger={"unexplained": 7, "rejected": 0, "produced": 1})
    with pytest.raises(EiaSecError, match="7 environment steps are unexplained"):
        result(watch, workers, started=80.0, ended=110.0)


def test_the_newest_report_of_a_worker_counts():
    """Shares are of all workers' times; without a report nobody waits."""
    times = WorkerTimes()
    assert times.waiting() == 0.0
    values = [{"waiting_seconds": wait, "simulating_seconds": 1.0} for wait in (9.0, 1.0)]
    reports = [SimpleNamespace(key="w", payload=MetricMessage(1, "h", 1, 1.0, v).encode()) for v in values]
    times.read(SimpleNamespace(drain=lambda: reports))  # type: ignore[arg-type]  # all that is read of a subscription
    assert times.waiting() == 0.5


def test_the_farm_is_measured_between_two_reports():
    """Only what lies within the time counts, and everything is the difference of the two."""
    first = a_status(time=10.0)
    last = a_status(
        time=20.0,
        environment_steps=80_000,
        updates=320,
        waits={"training": 8.0},
        ledger={"unexplained": 0, "rejected": 20_025, "produced": 0},
    )
    records = [a_status(time=9.0), first, {"kind": "episodes", "time": 15.0}, last, a_status(time=21.0)]
    assert between(records, 9.5, 20.5) == (first, last)
    with pytest.raises(ValueError, match="fewer than two reports"):
        between(records, 10.5, 20.5)
    found = rates(first, last)
    assert (found["steps_per_second"], found["updates_per_second"]) == (8000.0, 24.0)
    assert (found["update_ms"], found["learner_updating"], found["rejected_share"]) == (25.0, 0.6, 0.2)


def a_run(workers, seed, seconds, **changed):
    """Return a run of so many workers."""
    numbers = {"steps_per_second": 50.0 * workers, "environment_steps": 20_000, "seconds_from_launch": seconds + 9.0}
    shares = {"learner_updating": 0.1, "workers_waiting": 0.0, "rejected_share": 0.0, "update_ms": 3.0}
    curve = [(seconds / 2, 10_000, -18.0), (seconds, 20_000, -13.0)]
    return {
        **{"workers": workers, "seed": seed, "load": 0.5, "reached": True, "seconds": seconds, "curve": curve},
        **numbers,
        **shares,
        **changed,
    }


def results(*runs):
    """Return the results of some runs."""
    task = {"reward": -13.0, "window": 100, "period": 0.02, "chunk_steps": 25, "iteration_steps": 1000}
    farm = [{**a_run(n, 0, 60.0), "steps_per_second": 9000.0} for n in (1, 2)]
    return {"command": "c", "commit": "d", "cores": 2, "nice": 0, "task": task, "runs": list(runs), "farm": farm}


def test_speedups_are_of_medians():
    """A number of workers is compared by its median with one worker's; who was ended took longer than it had."""
    runs = [a_run(1, seed, seconds) for seed, seconds in enumerate((400.0, 420.0, 380.0))]
    runs += [a_run(16, seed, seconds) for seed, seconds in enumerate((25.0, 32.0, 20.0))]
    runs += [a_run(32, 0, 99.0, reached=False)]
    one, many, most = summary(runs)
    assert (one["speedup"], one["efficiency"]) == (1.0, 1.0)
    assert (many["seconds"], many["least"], many["most"], many["seeds"]) == (25.0, 20.0, 32.0, 3)
    assert (many["speedup"], many["efficiency"], many["steps_speedup"]) == (16.0, 1.0, 16.0)
    assert (most["reached"], most["speedup"], most["steps_speedup"]) == (0, None, 32.0)
    assert summary(runs[3:6])[0]["speedup"] is None


def test_what_is_missing_is_measured_and_every_run_is_kept(monkeypatch, tmp_path):
    """A second call goes on where the first was ended; other tasks or commits begin anew."""
    done = []

    def train(task, workers, seed):
        done.append((workers, seed))
        if len(done) == 3:
            raise EiaSecError("a process ended.")
        return a_run(workers, seed, 400.0 / workers)

    monkeypatch.setattr(command, "train", train)
    monkeypatch.setattr(command, "learn", lambda workers, seconds: {**a_run(workers, 0, seconds)})
    words = ["distribution", "--write", str(tmp_path), "--workers", "1", "2", "--seeds", "2", "--farm-workers", "1"]
    monkeypatch.setattr(sys, "argv", words)
    with pytest.raises(EiaSecError, match="a process ended"):
        command.main()
    assert done == [(1, 0), (2, 0), (1, 1)]
    assert command.main() == 0
    assert done[3:] == [(1, 1), (2, 1)]
    kept = json.loads((tmp_path / "results.json").read_text())
    assert ([run["workers"] for run in kept["runs"]], len(kept["farm"])) == ([1, 2, 1, 2], 1)
    assert "## The farm" in (tmp_path / "README.md").read_text()
    kept["commit"] = "another"
    (tmp_path / "results.json").write_text(json.dumps(kept))
    assert command.main() == 0
    assert len(done) == 9


def test_real_processes_train_until_the_reward():
    """Two workers fly, all their steps are explained, and the run ends by itself as soon as the reward is there."""
    found = train(Task(reward=-1000.0, period=0.001, limit=120.0), workers=2, seed=0)
    assert found["reached"]
    assert found["environment_steps"] >= 25 * WINDOW
    assert 0.0 < found["seconds"] < found["seconds_from_launch"]
    assert (found["workers"], found["rejected_share"]) == (2, 0.0)
    assert found["iterations"] >= 1


def test_a_process_that_only_waits_is_not_busy():
    """Workers have started when none of them computes any more."""
    sleeping, computing = (
        subprocess.Popen([sys.executable, "-c", f"print(flush=True)\n{code}"], stdout=subprocess.PIPE)
        for code in ("import time; time.sleep(600)", "while True: pass")
    )
    try:
        for process in (sleeping, computing):
            assert process.stdout is not None
            process.stdout.readline()
        assert not busy([sleeping.pid], 0.3)
        assert busy([sleeping.pid, computing.pid], 1.0)
    finally:
        for process in (sleeping, computing):
            process.kill()
            process.communicate()


@pytest.mark.parametrize("inherited", ["/elsewhere", ""])
def test_processes_find_what_this_process_finds(inherited, tmp_path, monkeypatch):
    """The source comes first on their path, and what `PYTHONPATH` names stays."""
    monkeypatch.setenv("PYTHONPATH", inherited)
    processes = Processes(RunConfig(), 1, tmp_path, routed=False)
    path = processes._supervisor._environment["PYTHONPATH"].split(os.pathsep)
    assert path == [str(ROOT / "src"), str(ROOT), *filter(None, [inherited])]
