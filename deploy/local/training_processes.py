"""The processes of one run on this machine: learner, coordinator and workers, and the session that watches them."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from eia_sec.common.config import RunConfig
from eia_sec.common.errors import BusError, CancelledError, EiaSecError, EndpointError, UsageError
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import CommandMessage
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import Endpoint
from eia_sec.deploy.exit_codes import USAGE
from eia_sec.deploy.local.code_options import env_options, plugin_options
from eia_sec.deploy.local.run_directory import CONFIG, HISTORY, RunDirectory
from eia_sec.deploy.local.supervisor import Child, Supervisor
from eia_sec.rollout.worker.sender import UNDELIVERED

DRAIN_SECONDS: Final = 8.0
JOIN_SECONDS: Final = 300.0
"""Seconds that workers and coordinator wait for the learner to listen."""
LISTEN_SECONDS: Final = 60.0
"""Seconds that the learner may take until it listens."""
ALONE_SECONDS: Final = 10.0
"""Time after which a learner that trains without any worker left is given up."""
LEARNER, COORDINATOR = "learner.learner", "elite.coordinator"
"""Certificates that they need besides rollout.0, rollout.1, ..."""


@dataclass(frozen=True)
class ProcessPlan:
    """What to start.

    Attributes:
        config: the run.
        workers: number of rollout workers.
        directory: the run directory, which holds the configuration.
        endpoint: where the learner listens, or where the router listens that all connect to.
        run: the run's name.
        router: whether a router listens there.
        lockstep, resume, shared_memory: as `eia-sec train` has them.
        tls: folder with a certificate for each process, or None.
        learners: learners that make the updates together; the first one starts the others.
        coordinated: whether an elite coordinator of its own is started; the members of a population have one together.
    """

    config: RunConfig
    workers: int
    directory: RunDirectory
    endpoint: Endpoint
    run: str = "train"
    router: bool = False
    lockstep: bool = False
    resume: bool = False
    shared_memory: bool = False
    tls: Path | None = None
    learners: int = 1
    coordinated: bool = True


class TrainingProcesses:
    """The processes of one run.

    Args:
        plan: what to start.

    Attributes:
        supervisor: starts, watches and restarts them.
        learner: the learner's process, once `start` was called.
    """

    def __init__(self, plan: ProcessPlan) -> None:
        self._plan = plan
        self.supervisor = Supervisor(plan.directory.path / "logs")
        self._alone = 0.0

    @property
    def learner(self) -> Child:
        """The learner."""
        return self.supervisor.children["learner"]

    def start(self) -> None:
        """Start all processes."""
        plan, where, folder = self._plan, str(self._plan.endpoint), self._plan.directory.path
        met = ["--connect", where, "--patience", str(JOIN_SECONDS)] if plan.router else ["--listen", where]
        named = plugin_options(plan.config)
        learner = ["learner", *named, "--run", plan.run, *met, "--run-dir", str(folder)]
        shared = ["--shared-memory"] if plan.shared_memory else []
        learner += [*shared, *self._tls(LEARNER)]
        learner += ["--config", str(folder / CONFIG), "--await-elite"]
        learner += ["--lockstep"] if plan.lockstep else []
        learner += ["--resume"] if plan.resume else []
        learner += [] if plan.learners == 1 else ["--learners", str(plan.learners)]
        again = [] if plan.resume or plan.lockstep else ["--resume"]
        self.supervisor.start("learner", learner, plan.config.learner.threads, again)
        joining = [*named, "--run", plan.run, "--connect", where, "--patience", str(JOIN_SECONDS)]
        if plan.coordinated:
            self.supervisor.start("elite", ["elite", *joining, *self._tls(COORDINATOR)])
        for index in range(plan.workers):
            rollout = [
                "rollout",
                *joining,
                "--name",
                str(index),
                *env_options(plan.config),
                *shared,
                *self._tls(f"rollout.{index}"),
            ]
            rollout += ["--history", str(folder / HISTORY / f"rollout-{index}.jsonl")]
            self.supervisor.start(f"rollout-{index}", rollout, plan.config.rollout.threads)

    def _tls(self, process: str) -> list[str]:
        folder = self._plan.tls
        return [] if folder is None else ["--tls", str(folder / process)]

    def connect(self, stopped: Callable[[], bool]) -> Bus | None:
        """Return a session with the learner, or None if it ends or the user stops first.

        Args:
            stopped: whether the user has stopped the run.
        """
        deadline = time.monotonic() + LISTEN_SECONDS
        while True:
            # One more try after a stop: a learner that has just begun to listen can still be asked to drain.
            stopping = stopped()
            waiting = (lambda: True) if stopping else (lambda: not stopped())
            try:
                return Bus.connect(self._plan.endpoint, "control", wait=0.5, waiting=waiting)
            except (EndpointError, CancelledError):
                self.supervisor.watch()
                if self.learner.done or stopping:
                    return None
                if self.learner.given_up or time.monotonic() > deadline:
                    self.raise_failure()
                    raise EndpointError("the learner did not start in time.") from None

    @property
    def over(self) -> bool:
        """Whether the learner has ended."""
        return self.learner.done or self.learner.given_up

    def watch(self, *, training: bool) -> None:
        """Restart processes that died.

        Args:
            training: whether the learner says that it trains.

        Raises:
            UsageError, EiaSecError: all workers have failed or ended, or in lockstep the coordinator.
        """
        self.supervisor.watch()
        children = self.supervisor.children
        workers = [child for name, child in children.items() if name.startswith("rollout-")]
        if workers and all(child.given_up for child in workers):
            last = self.supervisor.tail("rollout-0")
            if workers[0].code == USAGE and last:
                raise UsageError(last.splitlines()[-1].removeprefix("eia-sec: "))
            raise EiaSecError(f"all workers failed; one of them {workers[0].ending}{_last_lines(last)}")
        self._require_workers(workers, training=training)
        if self._plan.lockstep and children["elite"].given_up:
            last = self.supervisor.tail("elite")
            raise EiaSecError(f"the coordinator {children['elite'].ending}{_last_lines(last)}")

    def _require_workers(self, workers: Sequence[Child], *, training: bool) -> None:
        """Raise EiaSecError when a learner trains with nobody: code of others may end a worker as if it were done."""
        if not workers or not all(child.done or child.given_up for child in workers):
            self._alone = 0.0
        elif not self._alone:
            self._alone = time.monotonic()
        elif training and time.monotonic() - self._alone > ALONE_SECONDS:
            last = _last_lines(self.supervisor.tail("rollout-0"))
            raise EiaSecError(f"all workers have ended with exit code 0, and the run is not finished{last}")

    def undelivered(self) -> list[str]:
        """Return what workers that have ended say of steps that are lost with them."""
        workers = [name for name in self.supervisor.children if name.startswith("rollout-")]
        return [line for name in workers for line in self.supervisor.tail(name).splitlines() if UNDELIVERED in line]

    def set_arguments(self, bus: Bus, arguments: str) -> None:
        """Give the run's environments other arguments, a JSON object; raise BusError when the learner refuses them."""
        key = keys.COMMAND.key(self._plan.run, verb="arguments")
        bus.ask(key, CommandMessage("train", arguments).encode(), timeout=3.0)

    def drain(self, bus: Bus) -> str:
        """Let the learner write a checkpoint and end; return why it refused, or an empty string."""
        refused = self.ask_to_drain(bus)
        self.await_drained()
        return refused

    def ask_to_drain(self, bus: Bus) -> str:
        """Ask the learner to write a checkpoint and end; return why it refused, or an empty string."""
        try:
            bus.ask(keys.COMMAND.key(self._plan.run, verb="drain"), CommandMessage("train").encode(), timeout=3.0)
        except BusError as error:
            return str(error)
        return ""

    def await_drained(self) -> None:
        """Wait for a learner that was asked to end."""
        deadline = time.monotonic() + DRAIN_SECONDS
        while not self.learner.done and time.monotonic() < deadline:
            self.supervisor.watch()
            time.sleep(0.05)

    def raise_failure(self) -> None:
        """Raise the learner's error if it ended for good before the run was over."""
        if not self.learner.given_up:
            return
        last = self.supervisor.tail("learner")
        if self.learner.code == USAGE:
            reason = (last.splitlines() or ["the learner was refused, and there was no room to say why."])[-1]
            raise UsageError(reason.removeprefix("eia-sec: "))
        raise EiaSecError(f"the learner {self.learner.ending}{_last_lines(last)}")

    def stop(self) -> None:
        """End all processes."""
        self.supervisor.stop()


def _last_lines(text: str) -> str:
    """Return the end of a sentence about a process with its last lines."""
    return f"; its last lines were:\n{text}" if text else ", and said nothing."
