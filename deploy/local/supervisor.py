"""The child processes of one machine: started apart, watched, started again, and never left behind."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from common.process import SEPARATOR, SUPERVISOR, log
from deploy.exit_codes import USAGE
from deploy.local.threads import thread_environment

BACKOFF_SECONDS: Final = (0.5, 2.0, 5.0)
"""Pauses before a child that died is started again; after the last one it stays down."""
HEALTHY_SECONDS: Final = 60.0
"""A child that lived this long may die again without its earlier deaths counting."""
TERMINATE_SECONDS: Final = 8.0
KILL_SECONDS: Final = 2.0
TAIL_LINES: Final = 5


@dataclass
class Child:
    """One supervised process.

    Attributes:
        name: unique name, also of its log file.
        arguments: what follows `eia-sec`.
        threads: its share of compute threads.
        deaths: unexpected ends in a row.
        done: whether it ended as it should.
        given_up: whether it is no longer started again.
        code: its last exit code.
    """

    name: str
    arguments: list[str]
    threads: int
    process: subprocess.Popen[bytes] | None = None
    deaths: int = 0
    started: float = 0.0
    again_at: float | None = None
    done: bool = False
    given_up: bool = False
    code: int | None = None
    restart_arguments: list[str] = field(default_factory=list)


class Supervisor:
    """Starts `eia-sec` subcommands as processes of their own sessions and keeps them alive.

    Args:
        logs: folder for one log file per child.
        environment: variables on top of this process's own.
    """

    def __init__(self, logs: Path, environment: Mapping[str, str] | None = None) -> None:
        logs.mkdir(parents=True, exist_ok=True)
        self._logs = logs
        self._environment = dict(environment or {})
        self.children: dict[str, Child] = {}
        self.alarms: list[str] = []

    def start(
        self, name: str, arguments: Sequence[str], threads: int = 1, restart_arguments: Sequence[str] = ()
    ) -> Child:
        """Start a child; `restart_arguments` are added when it is started again."""
        child = Child(name, list(arguments), threads, restart_arguments=list(restart_arguments))
        self.children[name] = child
        self._spawn(child)
        return child

    def watch(self) -> None:
        """Notice children that ended, and start again those that should not have."""
        for child in self.children.values():
            if child.process is not None and child.process.poll() is not None:
                self._ended(child, child.process.returncode)
            if child.again_at is not None and time.monotonic() >= child.again_at:
                child.again_at = None
                self._spawn(child)

    def dismiss(self, name: str, number: int = signal.SIGTERM) -> None:
        """Tell a child to end, and do not wait for it; it is not started again."""
        child = self.children[name]
        child.again_at, child.done = None, True
        if child.process is not None and child.process.poll() is None:
            child.process.send_signal(number)

    def stop(self, names: Sequence[str] | None = None, seconds: float = TERMINATE_SECONDS) -> None:
        """End children: SIGTERM first, SIGKILL for those that have not gone after some seconds."""
        chosen = [self.children[name] for name in (self.children if names is None else names)]
        running = [child.process for child in chosen if child.process is not None and child.process.poll() is None]
        for child in chosen:
            child.again_at, child.done = None, True
        for number, patience in ((signal.SIGTERM, seconds), (signal.SIGKILL, KILL_SECONDS)):
            for process in running:
                if process.poll() is None:
                    process.send_signal(number)
            deadline = time.monotonic() + patience
            while running and time.monotonic() < deadline:
                running = [process for process in running if process.poll() is None]
                time.sleep(0.02)

    def tail(self, name: str) -> str:
        """Return the last lines that a child wrote."""
        try:
            lines = (self._logs / f"{name}.log").read_text(encoding="utf-8", errors="replace").splitlines()
        except OSError:
            return ""
        return "\n".join(lines[-TAIL_LINES:])

    def _spawn(self, child: Child) -> None:
        again = child.restart_arguments if child.deaths else []
        child.started = time.monotonic()
        environment = {
            **os.environ,
            **self._environment,
            SUPERVISOR: str(os.getpid()),
            "PYTHONUNBUFFERED": "1",
            **thread_environment(child.threads),
        }
        try:
            with (self._logs / f"{child.name}.log").open("ab") as output:
                child.process = subprocess.Popen(
                    [sys.executable, "-P", "-m", "deploy.cli", *child.arguments, *again],
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=output,
                    env=environment,
                    start_new_session=True,
                )
        except OSError as error:
            # No room for its log, or for one more process: there may be some when it is tried again.
            self._died(child, f"could not be started ({error.strerror})", [])

    def _ended(self, child: Child, code: int) -> None:
        child.process, child.code = None, code
        if child.done or code == 0:
            child.done = True
            return
        if time.monotonic() - child.started > HEALTHY_SECONDS:
            child.deaths = 0
        reason = f"signal {-code}" if code < 0 else f"exit code {code}"
        lines = self.tail(child.name).splitlines()
        self._died(child, f"ended with {reason}", lines, for_good=code == USAGE)

    def _died(self, child: Child, how: str, lines: Sequence[str], *, for_good: bool = False) -> None:
        """Say how a child came to its end, and give it up or plan its next start."""
        said = f": {lines[-1]}" if lines else ""
        if for_good or child.deaths >= len(BACKOFF_SECONDS):
            child.given_up = True
            self.alarm(f"{child.name} {how} and is not started again{said}", lines)
            return
        child.again_at = time.monotonic() + BACKOFF_SECONDS[child.deaths]
        child.deaths += 1
        self.alarm(f"{child.name} {how}; it is started again{said}", lines)

    def alarm(self, text: str, lines: Sequence[str] = ()) -> None:
        """Keep an alarm of one line, and log it with all that a child wrote last."""
        self.alarms.append(text[:300])
        del self.alarms[:-50]
        log(SEPARATOR.join((text, *lines[:-1])))
