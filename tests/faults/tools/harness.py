"""What the fault tests share: a run of real processes, its results, and a ledger that must close at the end."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import psutil

from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import MetricMessage
from eia_sec.common.transport.bus import Bus
from eia_sec.deploy.monitor.audit import Audit, audit
from tests.system.fleet import RUN, TINY, Processes, until

RESULTS_FOLDER = "EIA_SEC_RESULTS"
"""Environment variable with the folder for the results of full doses."""
SETTINGS = ("EIA_SEC_SOAK_MINUTES",)
"""Environment variables that choose a dose."""
LONG = TINY.replace("episodes = 8", "episodes = 1000000").replace("capacity = 4096", "capacity = 8192")
"""A run that ends only when it is asked to."""
BEHIND = LONG.replace("updates_per_step = 0.5", "updates_per_step = 4.0\nintake_chunks = 1")
BEHIND = BEHIND.replace("slack_steps = 400", "slack_steps = 40")
"""The same with a learner that is the bottleneck: its queue and the workers' spools stand full."""


def record_result(name: str, **values: Any) -> None:
    """Print a dose's results as JSON, and keep them where the environment says so."""
    values = {"name": name, **values}
    sys.stdout.write(json.dumps(values) + "\n")
    folder = os.environ.get(RESULTS_FOLDER)
    if folder:
        commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=False)
        current = os.environ.get("PYTEST_CURRENT_TEST", "").split(" ")[0]
        set_to = "".join(f"{name}={value} " for name, value in os.environ.items() if name in SETTINGS)
        command = f"{set_to}python -m pytest -m nightly {current}"
        values |= {"commit": commit.stdout.strip(), "command": command}
        Path(folder).mkdir(parents=True, exist_ok=True)
        (Path(folder) / f"{name}.json").write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")


def memory(process: subprocess.Popen[bytes]) -> float:
    """Return a process's resident memory in MiB."""
    return psutil.Process(process.pid).memory_info().rss / 2**20


def spread(values: list[float]) -> dict[str, float]:
    """Return the median and the largest of some numbers."""
    ordered = sorted(values) or [0.0]
    return {"median": round(ordered[len(ordered) // 2], 3), "most": round(ordered[-1], 3)}


class FaultRun(Processes):
    """Real processes with faults done to them."""

    def __init__(self, directory: Path, toml: str = LONG) -> None:
        super().__init__(directory, toml)

    def status(self) -> dict[str, Any]:
        """Return the learner's newest status, empty before the first."""
        path = self.directory / "run" / "metrics.jsonl"
        if not path.exists():
            return {}
        with path.open("rb") as file:
            file.seek(0, os.SEEK_END)
            file.seek(max(0, file.tell() - 65_536))
            lines = [line for line in file.read().decode().splitlines() if line.endswith("}")]
        found = [line for line in lines if line.startswith('{"kind": "status"')]
        return dict(json.loads(found[-1])) if found else {}

    def taken(self, worker: str = "") -> int:
        """Return the size of the learner's history, which grows with every chunk (of one worker: its lines)."""
        path = self.directory / "run" / "history" / "learner.jsonl"
        if not path.exists():
            return 0
        text = path.read_text(encoding="utf-8")
        return sum(1 for line in text.splitlines() if f'["accepted","{worker}' in line)

    @contextmanager
    def metrics(self, role: str, name: str) -> Iterator[Callable[[], list[dict[str, Any]]]]:
        """Give a function that returns all that a process has reported since."""
        heard: list[dict[str, Any]] = []
        with Bus.connect(self.endpoint, "control", 30.0) as bus:
            subscription = bus.subscribe(keys.METRIC.key(RUN, role=role, name=name), 1024)

            def listen() -> list[dict[str, Any]]:
                heard.extend(MetricMessage.decode(sample.payload).values for sample in subscription.drain())
                return heard

            yield listen

    def newest_incarnation(self, worker: str) -> int:
        """Return the incarnation of a worker's newest chunk that the learner has taken, 0 before the first."""
        return max((entry.incarnation for entry in self.accepted(worker)), default=0)

    def until_more(self, worker: str = "", seconds: float = 90.0) -> float:
        """Wait until the learner has taken another chunk (of one worker); return the seconds."""
        before, started = self.taken(worker), time.monotonic()
        until(lambda: self.taken(worker) > before, f"another chunk {worker}", seconds)
        return time.monotonic() - started

    def until_answered(self, worker: str, seconds: float = 90.0) -> float:
        """Wait until a worker knows of another chunk that the learner has taken; return the seconds.

        After a partition TCP sends what waits in each direction at times of its own, seconds apart.
        """
        before, started = self.steps_of("acknowledged", worker), time.monotonic()
        until(lambda: self.steps_of("acknowledged", worker) > before, f"another answer to {worker}", seconds)
        return time.monotonic() - started

    def until_led(self, since: str) -> None:
        """Wait until a coordinator has taken the lead that had not written so much into the log yet."""
        until(lambda: "coordinator coordinator leads." in self.log("elite")[len(since) :], "a coordinator that leads")

    def steps_of(self, verdict: str, worker: str) -> int:
        """Return the chunks of one verdict in a worker's own history."""
        path = self.directory / "run" / "history" / f"rollout-{worker}.jsonl"
        return sum(line.startswith(f'["{verdict}"') for line in path.read_text(encoding="utf-8").splitlines())

    def end(self, seconds: float = 60.0) -> float:
        """End the workers, which deliver what they hold, then everybody else; return the seconds that it took."""
        started = time.monotonic()
        workers = [name for name in self.running if name.startswith("rollout")]
        others = [name for name in self.running if name not in workers]
        for group in (workers, others):
            for name in group:
                self.running[name].send_signal(signal.SIGTERM)
            for name in group:
                assert (code := self.wait(name, seconds)) == 0, f"{name} ended with {code}:\n{self.log(name)}"
        return time.monotonic() - started

    def audit(self) -> Audit:
        """Return the audit of the run; fail unless everything is explained and nothing was counted twice."""
        found = audit(self.directory / "run")
        assert found.clean, found.to_dict()
        assert found.produced > 0
        return found


class Routed(FaultRun):
    """Processes that meet at a router, so that a learner or the router itself can be replaced."""

    def router(self) -> None:
        lanes = [self.endpoint.locator("control"), self.endpoint.locator("bulk")]
        command = [sys.executable, "-m", "tests.faults.tools.router", *lanes]
        with (self.directory / "router.log").open("ab") as log:
            self.running["router"] = subprocess.Popen(command, stdout=log, stderr=log, env=dict(os.environ))

    def learner_at(self, folder: str, *extra: str) -> subprocess.Popen[bytes]:
        where = ("--run", RUN, "--connect", str(self.endpoint), "--run-dir", str(self.directory / folder))
        return self.start(f"learner-{folder}", "learner", *where, *self.wanted, *extra)

    def end(self, seconds: float = 60.0) -> float:
        """End everybody in order, the router last."""
        router = self.running.pop("router")
        try:
            return super().end(seconds)
        finally:
            router.kill()
            router.wait(10.0)


@contextmanager
def run(directory: Path, toml: str = LONG) -> Iterator[FaultRun]:
    """Give processes that are gone afterwards, also those that stand still."""
    with closing(FaultRun(directory, toml)) as processes:
        yield processes
