"""`python -m research.studies`: the paper's studies, each by one command that goes on where it was stopped."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Literal

import tyro
from rich.console import Console

from eia_sec.common.config.checks import within
from eia_sec.common.errors import UsageError
from eia_sec.common.process import StopSignal
from eia_sec.deploy.exit_codes import DONE, INTERRUPTED
from eia_sec.deploy.local.run_directory import RunDirectory
from research.studies.bench import TWELVE, Bench
from research.studies.catalogue import STUDIES
from research.studies.jobs import Job, Records
from research.studies.pages.redraw import redraw
from research.studies.perform import perform_all
from research.studies.reproduce import Plan, announce_all, carry_out
from research.studies.runner import PROGRAM, RUN
from research.studies.scales import SCALES, Scale

ALL: Final = "all"
SCALABILITY: Final = "scalability"
LOCK: Final = "reproduce.lock"


@dataclass(frozen=True)
class ReproduceArguments:
    """Do one of the paper's studies, train the preset `eia-sec` over seeds, or do all of these.

    Says beforehand how long it takes. What is there already is kept, so the same command goes on after Ctrl-C.
    """

    study: tyro.conf.Positional[str] = ""
    """training, ablation, ensemble, scalability, inference, trajectories, default (the preset eia-sec), on_policy,
    observations, or all."""
    scale: Literal["smoke", "full"] = "full"
    """full: the study; smoke: a few minutes that show that everything works, and nothing else."""
    jobs: int = 1
    """Processes at a time, one thread each."""
    write: Path = Path("runs/reproduce")
    """Folder for data, pictures and tables; each study has its own in there."""
    records: Path = Path("runs/reproduce/records")
    """Folder of the finished runs, which all studies share."""
    seeds: int = 0
    """Seeds of every method; 0 for the study's own number."""
    uavs: tuple[int, ...] = ()
    """Team sizes of scalability; by default all of the scale's, and in any case 12, which the others stand beside."""
    plan: bool = False
    """Only say what is missing and how long it takes; the first pieces of runs are trained for the estimate."""
    redraw: bool = False
    """Only write data, pictures and pages again, from the finished runs; where some are missing, from the results."""

    def sizes(self) -> Scale:
        """Return the scale with what was asked for.

        Raises:
            UsageError: no study can have such seeds or teams.
        """
        within(0, 1000, seeds=self.seeds)
        scale = SCALES[self.scale]
        if self.seeds:
            scale = replace(
                scale, seeds=self.seeds, side_seeds=self.seeds, team_seeds=self.seeds, view_seeds=self.seeds
            )
        if self.uavs:
            if self.study != SCALABILITY:
                raise UsageError(f"--uavs is for {SCALABILITY} alone.")
            for uavs in self.uavs:
                within(3, 999, uavs=uavs)
            scale = replace(scale, uavs=tuple(sorted({TWELVE, *self.uavs})))
        return scale


def command(arguments: Sequence[str]) -> int:
    """Do a study; return 0 when its results are written, 130 when it was stopped."""
    if arguments[:1] == [RUN]:
        return _run(arguments[1:])
    options = tyro.cli(ReproduceArguments, args=arguments, prog=f"python -m {PROGRAM}")
    within(1, 1024, jobs=options.jobs)
    if options.study not in (*STUDIES, ALL):
        wrong = f"there is no study {options.study!r}" if options.study else "nothing to reproduce"
        raise UsageError(f"{wrong}; the studies are {', '.join(STUDIES)}, and {ALL}.")
    console = Console(highlight=False, soft_wrap=True, markup=False)
    bench = Bench(options.sizes(), Records(options.records))
    held = RunDirectory(options.records)
    if not options.redraw:  # which reads finished records alone, so another start may be at work on more
        held.lock(LOCK)  # as long as this object lives
    names = tuple(STUDIES) if options.study == ALL else (options.study,)
    # The scale is part of what was done, whether it was said or not.
    said = list(arguments) if "--scale" in arguments else [*arguments, "--scale", options.scale]
    said = [word for word in said if word != "--redraw"]  # without it the command makes the same
    plans = [Plan(name, bench, options.write, options.jobs, said, console.print) for name in names]
    if options.redraw:
        for plan in plans:
            redraw(plan)
        return DONE
    announce_all(plans)
    return DONE if options.plan else _carry_out(plans, console)


def _carry_out(plans: Sequence[Plan], console: Console) -> int:
    """Do studies one after another; return the exit code."""
    stop = StopSignal()
    stop.install()
    try:
        for plan in plans:
            if not carry_out(plan, stop):
                console.print("stopped; every finished run is kept, and the same command goes on from there.")
                return INTERRUPTED
    finally:
        stop.uninstall()
    return DONE


def _run(arguments: Sequence[str]) -> int:
    """Do runs of a study in this process."""
    if len(arguments) < 2:
        raise UsageError(f"{PROGRAM} {RUN} takes the command of a study and files RECORDS/JOB.job.json.")
    said, *paths = arguments
    perform_all([Job.from_file(Path(path)) for path in paths], Records(Path(paths[0]).parent), said)
    return DONE
