"""Workers join a run by hand, one after another, and one is killed: what they add, and what is lost.

    python -m experiments.network.second_worker [--workers 1 2 4 8]

The learner takes in and stores, but does not train (`replay.updates_per_step = 0`), so that the workers are what is
measured; with `--updates-per-step` it trains as well, which belongs into another file. The second worker is killed
after two were measured, and others take the places. Written to docs/results/second_worker.json.
"""

import json
import os
import signal
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import tyro

from common.config import RunConfig
from common.config.files import to_toml
from common.config.presets import PRESETS
from common.errors import EiaSecError, UsageError
from common.farm import farm_team
from common.protocol import keys
from common.protocol.messages import CommandMessage
from common.transport.bus import Bus
from common.transport.endpoint import Endpoint, free_endpoint
from deploy.exit_codes import run_command
from deploy.local.supervisor import Child, Supervisor
from deploy.monitor.run_monitor import RunMonitor
from deploy.reports.provenance import provenance

RUN = "second-worker"
OUTPUT: Final = Path("docs/results/second_worker.json")
PATIENCE: Final = 600.0
"""Seconds in which new workers must have delivered something."""


@dataclass(frozen=True)
class Arguments:
    """Measure what a second worker adds, and further ones."""

    workers: tuple[int, ...] = (1, 2)
    """Numbers of workers to measure: 1 2, then any larger ones."""
    seconds: float = 20.0
    """Length of each measurement, s."""
    settle: float = 15.0
    """Time for which workers fly before they are measured, s."""
    updates_per_step: float = 0.0
    """Updates per environment step; 0 measures the workers, more the whole run."""
    output: Path = OUTPUT
    """The result."""

    def check(self) -> None:
        """Raise UsageError when these cannot be measured together."""
        if self.workers[:2] != (1, 2) or any(a >= b for a, b in zip(self.workers, self.workers[1:], strict=False)):
            raise UsageError("--workers must begin with 1 2 and rise: the page shows what the second one adds.")
        if self.updates_per_step and self.output == OUTPUT:
            raise UsageError(f"{OUTPUT} is of a learner that does not train; name another --output.")

    def config(self) -> RunConfig:
        """Return what the learner is started with."""
        base = PRESETS["study"]
        warmup = base.replay.warmup_steps if self.updates_per_step else 0
        stored = replace(base.replay, updates_per_step=self.updates_per_step, warmup_steps=warmup)
        return replace(base, episodes=10_000_000, replay=stored)


class WorkerPool:
    """The workers of the run.

    Args:
        supervisor: starts them.
        endpoint: where the learner listens.
    """

    def __init__(self, supervisor: Supervisor, endpoint: Endpoint) -> None:
        self._supervisor, self._endpoint, self._started = supervisor, endpoint, 0
        self.alive: dict[str, Child] = {}

    def grow(self, number: int) -> None:
        """Start workers until there are so many; each has a name that nobody had before."""
        while len(self.alive) < number:
            name = str(self._started)
            words = ["rollout", "--run", RUN, "--connect", str(self._endpoint), "--name", name]
            self.alive[name] = self._supervisor.start(f"rollout-{name}", words)
            self._started += 1

    def kill_last(self) -> None:
        """Kill the newest one."""
        _, child = self.alive.popitem()
        os.kill(process_number(child), signal.SIGKILL)


def process_number(child: Child) -> int:
    """Return the number of a child's process, which must not have ended by itself."""
    if child.process is None or child.process.poll() is not None:
        raise EiaSecError(f"{child.name} has ended by itself.")
    return child.process.pid


def memory(children: Sequence[Child]) -> dict[str, float]:
    """Return the resident memory of processes in MiB, pages that they share counted in each (rss) and in parts (pss).

    Empty where the system does not report it.
    """
    found = {"Rss:": 0.0, "Pss:": 0.0}
    for child in children:
        path = Path(f"/proc/{process_number(child)}/smaps_rollup")
        if not path.exists():
            return {}
        for words in (line.split() for line in path.read_text(encoding="utf-8").splitlines()):
            if words[0] in found:
                found[words[0]] += int(words[1]) / 1024.0
    return {f"{name[:3].lower()}_mib": round(value, 1) for name, value in found.items()}


def rates(monitor: RunMonitor, seconds: float) -> dict[str, float]:
    """Return the environment steps and the updates per second of the learner over some seconds."""
    points = []
    for pause in (0.0, seconds):
        time.sleep(pause)
        monitor.update()
        points.append(monitor.learner_values())
    before, after = points
    duration = float(after["elapsed"]) - float(before["elapsed"])
    return {f"{name}_per_second": (after[name] - before[name]) / duration for name in ("environment_steps", "updates")}


def delivering(monitor: RunMonitor) -> set[str]:
    """Return the names of the workers from which something was accepted."""
    rows = monitor.snapshot().processes
    return {row.name for row in rows if row.role == "rollout" and row.ledger is not None and row.ledger.accepted}


def wait_for(monitor: RunMonitor, pool: WorkerPool, patience: float = PATIENCE) -> None:
    """Return when each worker has delivered something; raise EiaSecError when one does not."""
    deadline = time.monotonic() + patience
    while missing := set(pool.alive) - delivering(monitor):
        if time.monotonic() > deadline:
            raise EiaSecError(f"nothing came from the workers {', '.join(sorted(missing))} in {patience:.0f} s.")
        time.sleep(0.2)
        monitor.update()


def measure(arguments: Arguments, bus: Bus, monitor: RunMonitor, pool: WorkerPool, learner: Child) -> dict[str, Any]:
    """Return rates and memory by number of workers, the rate after one was killed, and the ledger at the end."""
    sweep: dict[int, dict[str, Any]] = {}
    after = 0.0
    for number in arguments.workers:
        pool.grow(number)
        wait_for(monitor, pool)
        time.sleep(arguments.settle)
        sweep[number] = {"workers": number, **rates(monitor, arguments.seconds)}
        sweep[number] |= {"learner": memory([learner]), "all_workers": memory(list(pool.alive.values()))}
        if number == 2:
            pool.kill_last()
            time.sleep(5.0)
            after = rates(monitor, arguments.seconds)["environment_steps_per_second"]
    bus.ask(keys.COMMAND.key(RUN, verb="drain"), CommandMessage(RUN).encode(), timeout=5.0)
    time.sleep(2.0)
    monitor.update()
    one, two = (sweep[number]["environment_steps_per_second"] for number in (1, 2))
    return {
        "cores": os.cpu_count(),
        "updates_per_step": arguments.updates_per_step,
        "environment_steps_per_second": {"one_worker": one, "two_workers": two, "after_kill": after},
        "gain": two / one,
        "sweep": list(sweep.values()),
        "ledger": monitor.learner_values()["ledger"],
    }


def main() -> None:
    """Measure and write the result."""
    arguments = tyro.cli(Arguments, prog="python -m experiments.network.second_worker")
    arguments.check()
    endpoint = free_endpoint()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "config.toml"
        path.write_text(to_toml(arguments.config()), encoding="utf-8")
        supervisor = Supervisor(Path(folder) / "logs")
        words = ["learner", "--run", RUN, "--listen", str(endpoint), "--config", str(path)]
        try:
            learner = supervisor.start("learner", words)
            with Bus.connect(endpoint, "control", wait=60.0) as bus:
                result = measure(arguments, bus, RunMonitor(bus, RUN), WorkerPool(supervisor, endpoint), learner)
        finally:
            supervisor.stop()
    origin = {**provenance("experiments.network.second_worker"), "team": farm_team(arguments.config().farm).digest}
    text = json.dumps({**origin, **result}, indent=1)
    arguments.output.parent.mkdir(parents=True, exist_ok=True)
    arguments.output.write_text(text + "\n", encoding="utf-8")
    sys.stdout.write(text + "\n")


if __name__ == "__main__":
    sys.exit(run_command(main))
