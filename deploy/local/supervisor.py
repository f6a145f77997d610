"""A supervisor of child processes: starts, watches and restarts them, and leaves none behind."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from eia_sec.common.log import SEPARATOR, log
from eia_sec.common.process import SUPERVISOR
from eia_sec.deploy.exit_codes import OUR_CODES, USAGE
from eia_sec.deploy.local.file_ends import last_lines
from eia_sec.deploy.local.memory_kills import kill_sentence, memory_kills
from eia_sec.deploy.local.threads import thread_environment

BACKOFF_SECONDS: Final = (0.5, 2.0, 5.0)
"""Pauses before each restart of a child that died; after the last one it is given up."""
HEALTHY_SECONDS: Final = 60.0
"""A child that ran this long before it died starts with a clean record."""
TERMINATE_SECONDS: Final = 8.0
KILL_SECONDS: Final = 2.0
FOREIGN: Final = "no command of ours ends with it; code of an environment or a library has ended the process"
TAIL_LINES: Final = 5
TAIL_BYTES: Final = 64 * 1024
"""Most bytes of a log that are looked at for its last lines."""


@dataclass
class Child:
    """One supervised process.

    Attributes:
        name: unique name, also of its log file.
        arguments: its words on the command line.
        threads: its share of compute threads.
        deaths: unexpected exits in a row.
        done: whether it exited as intended.
        given_up: whether it is not restarted any more.
        code: its last exit code.
        ending: how it ended last, as the rest of a sentence about it.
        kills: processes that the kernel had killed for lack of memory when it started.
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
    ending: str = ""
    kills: dict[str, int] = field(default_factory=dict)
    restart_arguments: list[str] = field(default_factory=list)


def _ended_with(process: subprocess.Popen[bytes]) -> int | None:
    """Return a child's exit code, or None while it runs; what it has left in its process group is killed."""
    before, code = process.returncode, process.poll()
    if before is None and code is not None:
        with suppress(ProcessLookupError, PermissionError):  # the latter where only zombies are left, on macOS
            os.killpg(process.pid, signal.SIGKILL)
    return code


def _reason(child: Child, code: int) -> tuple[str, str]:
    """Return how a child ended, and what is known about that beyond its own last line."""
    if code == -signal.SIGKILL:
        return "ended with signal 9", kill_sentence(child.kills)
    if code < 0:
        return f"ended with signal {-code}", ""
    return f"ended with exit code {code}", "" if code in OUR_CODES else FOREIGN


class Supervisor:
    """Starts commands in sessions of their own and restarts those that die.

    An environment may start processes. Those that a child did not end itself are killed once the child is gone.

    Args:
        logs: folder for one log file per child.
        environment: variables on top of this process's own.
        program: the module that the commands are arguments of.
    """

    def __init__(
        self, logs: Path, environment: Mapping[str, str] | None = None, program: str = "eia_sec.deploy.cli"
    ) -> None:
        logs.mkdir(parents=True, exist_ok=True)
        self._logs = logs
        self._environment = dict(environment or {})
        self._program = program
        self.children: dict[str, Child] = {}
        self.alarms: list[str] = []

    def start(
        self, name: str, arguments: Sequence[str], threads: int = 1, restart_arguments: Sequence[str] = ()
    ) -> Child:
        """Start a child; `restart_arguments` are added at each restart."""
        child = Child(name, list(arguments), threads, restart_arguments=list(restart_arguments))
        self.children[name] = child
        self._spawn(child)
        return child

    def watch(self) -> None:
        """Check for children that exited, and restart those that should run."""
        for child in self.children.values():
            if child.process is not None and (code := _ended_with(child.process)) is not None:
                self._ended(child, code)
            if child.again_at is not None and time.monotonic() >= child.again_at:
                child.again_at = None
                self._spawn(child)

    def dismiss(self, name: str, number: int = signal.SIGTERM) -> None:
        """Send a child a signal without waiting for it to exit; it is not restarted."""
        child = self.children[name]
        child.again_at, child.done = None, True
        if child.process is not None and child.process.poll() is None:
            child.process.send_signal(number)

    def stop(self, names: Sequence[str] | None = None, seconds: float = TERMINATE_SECONDS) -> None:
        """Stop children: SIGTERM first, SIGKILL for those that still run after some seconds."""
        chosen = [self.children[name] for name in (self.children if names is None else names)]
        started = [child.process for child in chosen if child.process is not None]
        running = [process for process in started if _ended_with(process) is None]
        for child in chosen:
            child.again_at, child.done = None, True
        for number, patience in ((signal.SIGTERM, seconds), (signal.SIGKILL, KILL_SECONDS)):
            for process in running:
                if process.poll() is None:
                    process.send_signal(number)
            deadline = time.monotonic() + patience
            while running and time.monotonic() < deadline:
                running = [process for process in running if _ended_with(process) is None]
                time.sleep(0.02)

    def tail(self, name: str) -> str:
        """Return the last lines of a child's log."""
        try:
            return "\n".join(last_lines(self._logs / f"{name}.log", TAIL_BYTES)[-TAIL_LINES:])
        except OSError:
            return ""

    def _spawn(self, child: Child) -> None:
        again = child.restart_arguments if child.deaths else []
        child.started, child.kills = time.monotonic(), memory_kills()
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
                    [sys.executable, "-P", "-m", self._program, *child.arguments, *again],
                    stdin=subprocess.DEVNULL,
                    stdout=output,
                    stderr=output,
                    env=environment,
                    start_new_session=True,
                )
        except OSError as error:
            # No room for its log or for one more process; there may be some at the next try.
            self._died(child, f"could not be started ({error.strerror})", "", [])

    def _ended(self, child: Child, code: int) -> None:
        child.process, child.code = None, code
        if child.done or code == 0:
            child.done = True
            return
        if time.monotonic() - child.started > HEALTHY_SECONDS:
            child.deaths = 0
        lines = self.tail(child.name).splitlines()
        self._died(child, *_reason(child, code), lines, for_good=code == USAGE)

    def _died(self, child: Child, how: str, why: str, lines: Sequence[str], *, for_good: bool = False) -> None:
        """Raise an alarm about a child that died, and give it up or schedule its restart."""
        child.ending = how + (f": {why}" if why else "")
        said = (f": {why}" if why else "") + (f"; its last line: {lines[-1]}" if lines and why else "")
        said = said or (f": {lines[-1]}" if lines else "")
        if for_good or child.deaths >= len(BACKOFF_SECONDS):
            child.given_up = True
            self.alarm(f"{child.name} {how} and is not restarted{said}", lines)
            return
        child.again_at = time.monotonic() + BACKOFF_SECONDS[child.deaths]
        child.deaths += 1
        self.alarm(f"{child.name} {how}; restarting it{said}", lines)

    def alarm(self, text: str, lines: Sequence[str] = ()) -> None:
        """Keep an alarm of one line, and log it with the last lines of a child."""
        self.alarms.append(text[:300])
        del self.alarms[:-50]
        log(SEPARATOR.join((text, *lines[:-1])))
