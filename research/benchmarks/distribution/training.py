"""One training until its reward is reached, by the clock of whoever waits for it."""

import os
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import from_toml
from eia_sec.common.errors import EiaSecError
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import MetricMessage, ProgressMessage
from eia_sec.common.transport.bus import Bus, Subscription
from research.benchmarks.distribution.processes import JOIN_SECONDS, RUN, Processes
from research.benchmarks.distribution.records import MovingReward, Record, Tail

REWARD: Final = -13.0
"""Reward per agent and episode that is waited for; random actions earn about -21."""
WINDOW: Final = 100
"""Episodes whose mean reward counts."""
LOOK_SECONDS: Final = 0.02
SETTINGS: Final = """
seed = {seed}
episodes = 1000000
[env]
name = "research.benchmarks.distribution.paced:parallel_env"
arguments = '{{"period": {period}}}'
[algorithm]
hidden = 64
discount = 0.9
reward_scale = 0.3
iteration_steps = 1000
epochs = 10
minibatch_steps = 250
actor_rate = 1e-3
critic_rate = 2e-3
rate_end = 1.0
target_kl = 0.05
objective = "decoupled"
entropy_start = 0.002
entropy_end = 0.002
precision = "float32"
[rollout]
environments = 1
chunk_steps = {chunk_steps}
train_farms = 1000
[learner]
checkpoint_seconds = 3600.0
"""
"""The run, over the preset instant. A worker holds one environment, as the process of a vehicle does."""


@dataclass(frozen=True)
class Task:
    """What is trained.

    Attributes:
        reward: reward per agent and episode at which the clock stops.
        period: seconds of a step.
        chunk_steps: steps of a chunk.
        limit: seconds of training after which a run is ended.
    """

    reward: float = REWARD
    period: float = 0.02
    chunk_steps: int = 25
    limit: float = 1200.0

    def config(self, seed: int) -> RunConfig:
        """Return the run with a seed."""
        text = SETTINGS.format(seed=seed, period=self.period, chunk_steps=self.chunk_steps)
        return from_toml(text, RunConfig())


@dataclass
class Watch:
    """What somebody sees who waits for a reward.

    Args:
        task: what is trained.

    Attributes:
        first: when the chunk began that was accepted first, s of the caller's clock; None before.
        reached: when the reward was reached; None before.
        steps: environment steps accepted by then.
        curve: seconds since the first transition, environment steps and mean reward, after each record.
        last: the learner's newest report.
    """

    task: Task
    first: float | None = None
    reached: float | None = None
    steps: int = 0
    curve: list[tuple[float, int, float]] = field(default_factory=list)
    last: Record = field(default_factory=dict)
    _reward: MovingReward = field(default_factory=lambda: MovingReward(WINDOW))

    def accepted(self, environment_steps: int, now: float) -> None:
        """Note how many environment steps the learner has accepted."""
        if self.first is None and environment_steps > 0:
            self.first = now - self.task.chunk_steps * self.task.period

    def add(self, records: Iterable[Record], now: float) -> None:
        """Take in new records of the learner."""
        for record in records:
            if record["kind"] == "status":
                self.last = record
            if record["kind"] == "episodes" and self.reached is None:
                self.accepted(record["environment_steps"], now)
                mean, self.steps = self._reward.add(record), record["environment_steps"]
                if mean is not None and self.first is not None:
                    self.curve.append((round(now - self.first, 2), self.steps, round(mean, 3)))
                    self.reached = now if mean >= self.task.reward else None

    def over(self, now: float) -> bool:
        """Return whether the reward is reached or the time is up."""
        return self.reached is not None or (self.first is not None and now - self.first > self.task.limit)


def train(task: Task, workers: int, seed: int) -> dict[str, Any]:
    """Train once with so many workers; return times, rates and where the time went.

    Raises:
        EiaSecError: when a process ends, nothing is accepted in time, or steps are unexplained.
    """
    with tempfile.TemporaryDirectory() as folder:
        load, started = os.getloadavg()[0], time.monotonic()
        with Processes(task.config(seed), workers, Path(folder), routed=True) as processes:
            watch, reports = Watch(task), WorkerTimes()
            tail = Tail(processes.metrics)
            with Bus.connect(processes.endpoint, "control", wait=JOIN_SECONDS) as bus:
                progress = bus.subscribe_state(keys.PROGRESS.key(RUN))
                metrics = bus.subscribe(keys.METRIC.pattern(RUN, role="rollout"), 4096)
                deadline = time.monotonic() + JOIN_SECONDS
                while not watch.over(now := time.monotonic()):
                    processes.check()
                    if (sample := progress.poll()) is not None:
                        watch.accepted(ProgressMessage.decode(sample.payload).environment_steps, now)
                    watch.add(tail.new(), now)
                    reports.read(metrics)
                    if watch.first is None and now > deadline:
                        raise EiaSecError("the learner accepted nothing in time.")
                    time.sleep(LOOK_SECONDS)
                ended = time.monotonic()
                processes.drain(bus)
                watch.add(tail.new(), ended)
        return {"workers": workers, "seed": seed, "load": load, **result(watch, reports, started, ended)}


class WorkerTimes:
    """The newest report of each worker."""

    def __init__(self) -> None:
        self._newest: dict[str, dict[str, Any]] = {}

    def read(self, reports: Subscription) -> None:
        """Take in the reports that have come."""
        for sample in reports.drain():
            self._newest[sample.key] = MetricMessage.decode(sample.payload).values

    def waiting(self) -> float:
        """Return the share of their time for which workers waited for the learner, 0..1."""
        waited = sum(values["waiting_seconds"] for values in self._newest.values())
        whole = waited + sum(values["simulating_seconds"] for values in self._newest.values())
        return waited / whole if whole else 0.0


def result(watch: Watch, workers: WorkerTimes, started: float, ended: float) -> dict[str, Any]:
    """Return what one training has shown.

    Args:
        watch: what was seen.
        workers: the workers' reports.
        started: when the first process was started, s.
        ended: when the training was over, s.
    """
    assert watch.first is not None
    seconds, last, ledger = ended - watch.first, watch.last, watch.last["ledger"]
    if ledger["unexplained"]:
        raise EiaSecError(f"{ledger['unexplained']} environment steps are unexplained.")
    statistics = last["statistics"]
    return {
        "reached": watch.reached is not None,
        "seconds": round(seconds, 2),
        "seconds_to_first": round(watch.first - started, 2),
        "seconds_from_launch": round(ended - started, 2),
        "environment_steps": watch.steps,
        "steps_per_second": round(watch.steps / seconds, 1),
        "updates": last["updates"],
        "update_ms": round(1e3 * last["waits"]["training"] / max(1, last["updates"]), 2),
        "learner_updating": round(min(1.0, last["waits"]["training"] / seconds), 4),
        "workers_waiting": round(workers.waiting(), 4),
        "rejected_share": round(ledger["rejected"] / max(1, ledger["produced"]), 4),
        "iterations": int(statistics["iterations"]),
        "curve": watch.curve[:: max(1, len(watch.curve) // 100)],
    }
