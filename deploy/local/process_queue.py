"""Does pieces of work in processes of their own, so many at a time."""

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

from eia_sec.common.errors import EiaSecError
from eia_sec.common.process import StopSignal
from eia_sec.deploy.local.supervisor import Child, Supervisor

PROGRESS: Final = "progress"
"""First word of the lines by which a process reports on standard output how far it is: `progress 0.25`."""
LOOK_SECONDS: Final = 0.2
REPORT_SECONDS: Final = 30.0
"""Pause between two lines on how far everything is."""
LEAST_SHARE: Final = 0.01
"""Share that must be done before it is said how long the rest takes."""


class Work(ABC):
    """What one process does.

    Args:
        name: of the process and its log; one among all.
        label: what people call it.
        arguments: the process's words on the command line.
        seconds: how long it is expected to take, or any number where nothing is known and all are alike.
    """

    def __init__(self, name: str, label: str, arguments: Sequence[str], seconds: float) -> None:
        self.name, self.label, self.arguments, self.seconds = name, label, arguments, seconds

    @abstractmethod
    def begin(self, stop: StopSignal) -> bool:
        """Prepare what the process reads; return False where `stop` came first."""

    @abstractmethod
    def is_done(self) -> bool:
        """Return whether its result is there."""

    @abstractmethod
    def clean(self) -> None:
        """Remove what only the process needed, once its result is there."""


class ProcessQueue:
    """Starts work as processes end.

    Args:
        supervisor: starts the processes.
        logs: its folder of logs.
        at_once: processes at a time.
        report: takes each line for the user.
        threads: compute threads of each process.
    """

    def __init__(
        self, supervisor: Supervisor, logs: Path, at_once: int, report: Callable[[str], None], threads: int = 1
    ) -> None:
        self._supervisor, self._logs, self._threads = supervisor, logs, threads
        self._at_once, self._report = at_once, report

    def run(self, work: Sequence[Work], stop: StopSignal) -> bool:
        """Do all of it, in this order.

        Args:
            work: what to do.
            stop: ends everything that runs; what runs then leaves no result.

        Returns:
            Whether all is done, rather than stopped.

        Raises:
            EiaSecError: processes ended without a result; those that did not have theirs.
        """
        try:
            failed = self._work(work, stop)
        finally:
            self._supervisor.stop()
        if failed:
            last = self._supervisor.tail(failed[0].name)
            said = f"{len(failed)} of {len(work)} processes failed; the last lines of {failed[0].label}:"
            raise EiaSecError(f"{said}\n{last}")
        return not stop

    def _work(self, work: Sequence[Work], stop: StopSignal) -> list[Work]:
        supervisor = self._supervisor
        waiting, running, clock = list(work), list[Work](), _Clock(self._at_once)
        total, done, failed, reported = len(work), 0, list[Work](), time.monotonic()
        while (waiting or running) and not stop:
            while waiting and len(running) < self._at_once and waiting[0].begin(stop):
                one = waiting.pop(0)
                self._log(one).unlink(missing_ok=True)  # what a stopped process printed is not this one's
                supervisor.start(one.name, one.arguments, self._threads)
                running.append(one)
            stop.event.wait(LOOK_SECONDS)
            supervisor.watch()
            for one in [one for one in running if _over(supervisor.children[one.name])]:
                running.remove(one)
                if not one.is_done():
                    failed.append(one)
                    continue
                done += 1
                took = time.monotonic() - supervisor.children[one.name].started
                clock.finished(one, took)
                one.clean()
                self._log(one).unlink(missing_ok=True)
                self._report(f"{done}/{total} {one.label}: {duration(took)}")
            if time.monotonic() - reported > REPORT_SECONDS and running:
                reported = time.monotonic()
                shares = {one: self._far(one) for one in running}
                parts = ", ".join(f"{one.label} {share:.0%}" for one, (share, _) in shares.items())
                left = clock.left(waiting, shares)
                to_go = "" if left is None else f"; {duration(left)} to go"
                self._report(f"{done}/{total} done; {parts}{to_go}")
        return failed

    def _far(self, one: Work) -> tuple[float, float]:
        """Return the share of some work that is done, and the seconds since it began."""
        child = self._supervisor.children[one.name]
        return progress(self._supervisor.tail(one.name)), time.monotonic() - child.started

    def _log(self, one: Work) -> Path:
        return self._logs / f"{one.name}.log"


class _Clock:
    """Corrects what work is expected to take by what finished work took, and by how far running work is."""

    def __init__(self, at_once: int) -> None:
        self._at_once = at_once
        self._took = self._expected = 0.0

    def finished(self, one: Work, took: float) -> None:
        """Note how long a process took."""
        self._took += took
        self._expected += one.seconds

    def left(self, waiting: Sequence[Work], running: Mapping[Work, tuple[float, float]]) -> float | None:
        """Return the seconds until everything is done, or None where nothing has come far enough to say.

        Args:
            waiting: what has not begun.
            running: the share that is done and the seconds since the beginning, of what runs.
        """
        done = self._expected + sum(one.seconds * share for one, (share, _) in running.items())
        begun = [one.seconds * (1.0 - share) for one, (share, _) in running.items()]
        whole = sum(one.seconds for one in waiting) + sum(begun)
        if done < LEAST_SHARE * (self._expected + whole):
            return None
        pace = (self._took + sum(seconds for _, seconds in running.values())) / done
        return pace * max(whole / self._at_once, *begun, 0.0)


def duration(seconds: float) -> str:
    """Return a time as people say it."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


def progress(lines: str) -> float:
    """Return the share that the last line of a process's output reports, 0 when it reports none."""
    for line in reversed(lines.splitlines()):
        word, _, number = line.partition(" ")
        if word == PROGRESS:
            try:
                return min(1.0, max(0.0, float(number)))
            except ValueError:
                return 0.0
    return 0.0


def _over(child: Child) -> bool:
    return child.done or child.given_up
