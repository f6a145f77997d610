"""Does the jobs of a study in processes of one compute thread each, so many at a time."""

import os
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import Final

from eia_sec.common.errors import EiaSecError
from eia_sec.common.process import StopSignal
from eia_sec.deploy.local.supervisor import Child, Supervisor
from research.studies.estimate import STARTUP_SECONDS
from research.studies.jobs import JOB_SUFFIX, Job, Records
from research.studies.perform import PROGRESS, StoppedError, kept

PROGRAM: Final = "research.studies"
RUN: Final = "run"
"""The word, in a study's place, by which studies start their runs: `run COMMAND RECORDS/JOB.job.json ...`."""
LOOK_SECONDS: Final = 0.2
LOAD_SECONDS: Final = 60.0
"""Short jobs share a process, whose start takes longer than they do, until they take about so long."""
REPORT_SECONDS: Final = 30.0
"""Pause between two lines on how far everything is."""


class Runner:
    """Does jobs and keeps their records.

    Args:
        records: where records go; logs of running jobs go beside them.
        at_once: processes at a time.
        command: the study's command line, for the records.
        report: takes each line for the user.
    """

    def __init__(self, records: Records, at_once: int, command: str, report: Callable[[str], None]) -> None:
        self._records, self._at_once, self._command, self._report = records, at_once, command, report
        self._logs = records.folder / "logs"

    def run(self, jobs: Sequence[Job], seconds: Mapping[str, float], stop: StopSignal) -> bool:
        """Do jobs that have no record.

        Args:
            jobs: what to do, in this order.
            seconds: what each is expected to take, by digest.
            stop: ends everything that runs; what runs then leaves no record.

        Returns:
            Whether all are done, rather than stopped.

        Raises:
            EiaSecError: jobs failed; those that did not have their records.
        """
        supervisor = Supervisor(self._logs, {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}, PROGRAM)
        loads = packed(jobs, seconds)
        try:
            failed = self._work(supervisor, loads, stop)
        finally:
            supervisor.stop()
        if failed:
            last = supervisor.tail(failed[0].name)
            raise EiaSecError(f"{len(failed)} of {len(loads)} processes failed; the last lines of {failed[0]}:\n{last}")
        return not stop

    def _work(self, supervisor: Supervisor, loads: Sequence["Load"], stop: StopSignal) -> list["Load"]:
        waiting, running, clock = list(loads), list["Load"](), _Clock(self._at_once)
        total, done, failed, reported = len(loads), 0, list["Load"](), time.monotonic()
        while (waiting or running) and not stop:
            with suppress(StoppedError):
                while waiting and len(running) < self._at_once:
                    self._start(supervisor, waiting[0], stop)
                    running.append(waiting.pop(0))
            stop.event.wait(LOOK_SECONDS)
            supervisor.watch()
            for load in [load for load in running if _over(supervisor.children[load.name])]:
                running.remove(load)
                if self._records.missing(load.jobs):
                    failed.append(load)
                    continue
                done += 1
                took = time.monotonic() - supervisor.children[load.name].started
                clock.finished(load, took)
                self._clean(load)
                self._report(f"{done}/{total} {load}: {duration(took)}")
            if time.monotonic() - reported > REPORT_SECONDS and running:
                reported = time.monotonic()
                shares = {load: progress(supervisor.tail(load.name)) for load in running}
                parts = ", ".join(f"{load} {share:.0%}" for load, share in shares.items())
                self._report(f"{done}/{total} done; {parts}; {duration(clock.left(waiting, shares))} to go")
        return failed

    def _start(self, supervisor: Supervisor, load: "Load", stop: StopSignal) -> None:
        def ignore(share: float) -> None:
            if stop:
                raise StoppedError("stopped before it was begun.")

        for job in load.jobs:
            kept(partial(self._records.hand_over, job), ignore)
        paths = [self._records.path(job, JOB_SUFFIX) for job in load.jobs]
        (self._logs / f"{load.name}.log").unlink(missing_ok=True)  # what a stopped run printed is not this one's
        supervisor.start(load.name, [RUN, self._command, *map(str, paths)])

    def _clean(self, load: "Load") -> None:
        for job in load.jobs:
            self._records.path(job, JOB_SUFFIX).unlink(missing_ok=True)
        (self._logs / f"{load.name}.log").unlink(missing_ok=True)


@dataclass(frozen=True)
class Load:
    """Jobs that one process does one after another.

    Attributes:
        jobs: the jobs.
        seconds: what they are expected to take together.
    """

    jobs: list[Job]
    seconds: float

    @property
    def name(self) -> str:
        """Return what the process and its log are called."""
        return self.jobs[0].digest

    def __str__(self) -> str:
        """Return what people call it."""
        more = len(self.jobs) - 1
        return self.jobs[0].label + (f" and {more} more" if more else "")

    def __hash__(self) -> int:
        """Return a hash that goes with the name."""
        return hash(self.name)


def packed(jobs: Sequence[Job], seconds: Mapping[str, float]) -> list[Load]:
    """Return jobs as loads of about LOAD_SECONDS, in their order; longer jobs have a process of their own."""
    loads: list[Load] = []
    for job in jobs:
        whole = seconds[job.digest]
        own = max(0.0, whole - STARTUP_SECONDS)
        if loads and loads[-1].seconds + own <= LOAD_SECONDS:
            loads[-1] = Load([*loads[-1].jobs, job], loads[-1].seconds + own)
        else:
            loads.append(Load([job], whole))
    return loads


class _Clock:
    """Corrects estimates by the times that finished loads took."""

    def __init__(self, at_once: int) -> None:
        self._at_once = at_once
        self._took = self._expected = 0.0

    def finished(self, load: Load, took: float) -> None:
        """Note how long a load took."""
        self._took += took
        self._expected += load.seconds

    def left(self, waiting: Sequence[Load], shares: Mapping[Load, float]) -> float:
        """Return the seconds until everything is done."""
        pace = self._took / self._expected if self._expected else 1.0
        begun = [load.seconds * (1.0 - share) for load, share in shares.items()]
        whole = sum(load.seconds for load in waiting) + sum(begun)
        return pace * max(whole / self._at_once, *begun, 0.0)


def duration(seconds: float) -> str:
    """Return a time as people say it."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"


def progress(lines: str) -> float:
    """Return the share that the last line of a job's output reports, 0 when it reports none."""
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
