"""Does the jobs of a study in processes of one compute thread each, so many at a time."""

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

from eia_sec.common.process import StopSignal
from eia_sec.deploy.local.process_queue import ProcessQueue, Work
from eia_sec.deploy.local.supervisor import Supervisor
from research.studies.estimate import STARTUP_SECONDS
from research.studies.jobs import JOB_SUFFIX, Job, Records
from research.studies.perform import StoppedError, kept

PROGRAM: Final = "research.studies"
RUN: Final = "run"
"""The word, in a study's place, by which studies start their runs: `run COMMAND RECORDS/JOB.job.json ...`."""
LOAD_SECONDS: Final = 60.0
"""Short jobs share a process, whose start takes longer than they do, until they take about so long."""


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
        work = [_Process(load, self._records, self._command) for load in packed(jobs, seconds)]
        return ProcessQueue(supervisor, self._logs, self._at_once, self._report).run(work, stop)


@dataclass(frozen=True)
class Load:
    """Jobs that one process does one after another.

    Attributes:
        jobs: the jobs.
        seconds: what they are expected to take together.
    """

    jobs: list[Job]
    seconds: float

    def __str__(self) -> str:
        """Return what people call it."""
        more = len(self.jobs) - 1
        return self.jobs[0].label + (f" and {more} more" if more else "")


class _Process(Work):
    """The process that does a load."""

    def __init__(self, load: Load, records: Records, command: str) -> None:
        self._jobs, self._records = load.jobs, records
        paths = [str(records.path(job, JOB_SUFFIX)) for job in load.jobs]
        super().__init__(load.jobs[0].digest, str(load), [RUN, command, *paths], load.seconds)

    def begin(self, stop: StopSignal) -> bool:
        def ignore(share: float) -> None:
            if stop:
                raise StoppedError("stopped before it was begun.")

        try:
            for job in self._jobs:
                kept(partial(self._records.hand_over, job), ignore)
        except StoppedError:
            return False
        return True

    def is_done(self) -> bool:
        return not self._records.missing(self._jobs)

    def clean(self) -> None:
        for job in self._jobs:
            self._records.path(job, JOB_SUFFIX).unlink(missing_ok=True)


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
