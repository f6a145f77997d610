"""The processes of one run, as users start them: router, workers, coordinator and learner, on this machine."""

import os
import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Final, Self

import psutil

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import to_toml
from eia_sec.common.errors import BusError, EiaSecError
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import CommandMessage
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.deploy.local.run_directory import METRICS
from eia_sec.deploy.local.supervisor import Supervisor
from research.benchmarks.peers.catalogue import SOURCES

RUN: Final = "distribution"
JOIN_SECONDS: Final = 300.0
"""Longest wait for a listener, and for workers to have started."""
END_SECONDS: Final = 60.0
"""Longest wait for a learner that drains."""
IDLE_SHARE: Final = 0.1
"""Share of a core below which a process is taken to wait."""
LOOK_SECONDS: Final = 1.0


class Processes:
    """One run's processes; leaving the `with` block ends them all.

    With a router, workers start first and wait until the learner comes, so that all of them begin together. Without
    one the learner listens, as in `eia-sec train`.

    Args:
        config: the run.
        workers: number of workers.
        folder: where configuration, logs and the run directory go.
        routed: whether a router stands between them.
    """

    def __init__(self, config: RunConfig, workers: int, folder: Path, *, routed: bool) -> None:
        self._config, self._workers, self._routed = config, workers, routed
        self._file, self.metrics = folder / "config.toml", folder / "run" / METRICS
        self._file.write_text(to_toml(config), encoding="utf-8")
        # The environment's module lies in the source, not in the installed packages.
        paths = [SOURCES, *filter(None, [os.environ.get("PYTHONPATH")])]
        self._supervisor = Supervisor(folder / "logs", {"PYTHONPATH": os.pathsep.join(paths)})
        self.endpoint = free_endpoint()
        self.started = time.monotonic()

    def __enter__(self) -> Self:
        """Start everything."""
        try:
            self._start()
        except BaseException:
            self._supervisor.stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End everything."""
        self._supervisor.stop()

    def _start(self) -> None:
        where = ("--run", RUN, "--connect", str(self.endpoint), "--patience", str(JOIN_SECONDS))
        learner = ["learner", "--config", str(self._file), "--run-dir", str(self.metrics.parent)]
        allowed = ["--env", self._config.env.name] if self._config.env.is_third_party else []
        if self._routed:
            self._supervisor.start("router", ["router", "--listen", str(self.endpoint)])
        else:
            listen = ("--run", RUN, "--listen", str(self.endpoint))
            self._supervisor.start("learner", [*learner, *listen], self._config.learner.threads)
        for index in range(self._workers):
            words = ["rollout", *where, "--name", str(index), *allowed]
            self._supervisor.start(f"rollout-{index}", words, self._config.rollout.threads)
        self._supervisor.start("elite", ["elite", *where])
        if self._routed:
            self._wait_for_workers()
            self._supervisor.start("learner", [*learner, *where], self._config.learner.threads)

    def _wait_for_workers(self) -> None:
        """Return when every worker has started and only waits for the learner."""
        deadline = time.monotonic() + JOIN_SECONDS
        while busy(self._pids("rollout-"), LOOK_SECONDS):
            self.check()
            if time.monotonic() > deadline:
                raise EiaSecError("the workers did not start in time.")

    def _pids(self, prefix: str) -> list[int]:
        children = self._supervisor.children.items()
        return [child.process.pid for name, child in children if name.startswith(prefix) and child.process is not None]

    def check(self) -> None:
        """Raise EiaSecError when a process has ended; a run that lost one measures nothing."""
        self._supervisor.watch()
        if self._supervisor.alarms:
            raise EiaSecError(self._supervisor.alarms[0])

    def drain(self, bus: Bus) -> None:
        """Let the learner end, and return when it has."""
        try:
            bus.ask(keys.COMMAND.key(RUN, verb="drain"), CommandMessage("benchmark").encode(), timeout=5.0)
        except BusError as error:
            raise EiaSecError(f"the learner did not drain: {error}") from error
        deadline = time.monotonic() + END_SECONDS
        learner = self._supervisor.children["learner"]
        while not learner.done:
            self._supervisor.watch()
            if time.monotonic() > deadline:
                raise EiaSecError("the learner did not end in time.")
            time.sleep(0.05)


def busy(pids: Sequence[int], seconds: float) -> bool:
    """Return whether any process takes more than IDLE_SHARE of a core over some seconds."""
    processes = [psutil.Process(pid) for pid in pids]
    before = [sum(process.cpu_times()[:2]) for process in processes]
    time.sleep(seconds)
    taken = [sum(process.cpu_times()[:2]) - used for process, used in zip(processes, before, strict=True)]
    return max(taken, default=0.0) > IDLE_SHARE * seconds
