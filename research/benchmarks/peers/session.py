"""One session: every program in turn, repeated, with the same stated number of threads."""

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from eia_sec.common.config.presets import preset
from eia_sec.common.errors import EiaSecError
from eia_sec.common.farm import farm_team
from eia_sec.deploy.local.threads import thread_environment
from research.benchmarks.peers.catalogue import OURS, ROOT, SOURCES, Program
from research.benchmarks.peers.venvs import interpreter

LIMIT = 1800.0
"""Seconds after which a program counts as failed."""
Line = dict[str, Any]


class ProgramError(EiaSecError):
    """A program that failed, or that printed no result."""


@dataclass(frozen=True)
class Job:
    """One run of a program.

    Attributes:
        program: the program.
        threads: threads that it may use in each process.
        processes: processes.
    """

    program: Program
    threads: int
    processes: int = 1


@dataclass(frozen=True)
class Plan:
    """What is measured, in all programs alike.

    Attributes:
        threads: numbers of threads.
        repeats: how often the whole sequence is run.
        seconds: measuring time of each case of a simulator, s.
        updates: updates of each case of a learner.
        widths: widths of the networks.
        batches: numbers of environments.
    """

    threads: tuple[int, ...]
    repeats: int
    seconds: float
    updates: int
    widths: tuple[int, ...]
    batches: tuple[int, ...]


def jobs(programs: tuple[Program, ...], plan: Plan) -> list[Job]:
    """Return the runs of one repeat: by number of threads, and for each of these all programs in turn."""
    found = []
    for threads in plan.threads:
        for program in programs:
            if threads == 1 or program.threaded:
                found.append(Job(program, threads))
            if threads > 1 and program.processes:
                found.append(Job(program, 1, threads))
    return found


def arguments(job: Job, plan: Plan) -> list[str]:
    """Return the command line of a program's run, without the interpreter."""
    program, command = job.program, ["-m", job.program.module, "--threads", str(job.threads)]
    if program.subject == "simulator":
        command += ["--seconds", str(plan.seconds), "--batches", *map(str, plan.batches)]
        return command if job.processes == 1 else [*command, "--processes", str(job.processes)]
    command += ["--updates", str(plan.updates), "--widths", *map(str, plan.widths)]
    if program.environment == OURS:
        return [*command, "--json"]
    groups = [
        f"{g.name}:{g.count}:{g.observation_size}:{g.action_size}" for g in farm_team(preset("study").farm).groups
    ]
    return [*command, "--groups", *groups]


def parse(job: Job, output: str) -> tuple[list[Line], dict[str, str]]:
    """Return the lines that a program printed, and the versions of its packages.

    Raises:
        ProgramError: the last line is no result.
    """
    last = output.strip().rpartition("\n")[2]
    try:
        result = json.loads(last)
    except json.JSONDecodeError as error:
        raise ProgramError(f"{job.program.module} printed no result.") from error
    if "updates" in result:
        return [{"software": "EIA-SEC", "form": "", **line} for line in result["updates"]], {}
    return result["lines"], result["versions"]


def run(job: Job, plan: Plan, venvs: Path) -> tuple[list[Line], dict[str, str]]:
    """Run a program once.

    Raises:
        ProgramError: it failed.
    """
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    environment |= thread_environment(job.threads)
    if job.program.environment != OURS:
        environment["OPENBLAS_NUM_THREADS"] = str(job.threads)
    if job.program.environment == OURS:
        environment["PYTHONPATH"] = SOURCES
    command = [str(interpreter(job.program, venvs)), *arguments(job, plan)]
    sys.stderr.write(f"{job.program.subject}: {job.program.name}, threads {job.threads}, processes {job.processes}\n")
    try:
        done = subprocess.run(
            command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False, timeout=LIMIT
        )
    except subprocess.TimeoutExpired as error:
        raise ProgramError(f"{job.program.module} was not done after {LIMIT:.0f} s.") from error
    if done.returncode:
        said = done.stderr.strip().rpartition("\n")[2]
        raise ProgramError(f"{job.program.module} failed with {job.threads} threads: {said}")
    return parse(job, done.stdout)
