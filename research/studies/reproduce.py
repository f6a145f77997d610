"""What `python -m research.studies` does: say how long it takes, do what is missing, write data, pictures, a page."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from eia_sec.common.errors import RunDirError
from eia_sec.common.process import StopSignal
from eia_sec.deploy.local.process_queue import duration
from eia_sec.deploy.reports.provenance import command, made_by
from research.studies.bench import Bench
from research.studies.catalogue import STUDIES
from research.studies.estimate import Estimator
from research.studies.jobs import Job
from research.studies.pages.plots import RESULTS, save_pictures
from research.studies.pages.tables import SECTIONS, page
from research.studies.runner import PROGRAM, Runner, packed
from research.studies.scales import FULL

PAGE: Final = "README.md"


@dataclass(frozen=True)
class Plan:
    """What is to be done.

    Attributes:
        study: the study's name.
        bench: its scale and records.
        write: folder for the folders of all studies.
        at_once: processes at a time.
        arguments: the command line behind `python -m research.studies`, for the record.
        report: takes each line for the user.
    """

    study: str
    bench: Bench
    write: Path
    at_once: int
    arguments: Sequence[str]
    report: Callable[[str], None]

    @property
    def folder(self) -> Path:
        """Return the study's own folder; a smoke run's lies apart, so that it never takes the place of a full one's."""
        scale = self.bench.scale.name
        return self.write / self.study if scale == FULL.name else self.write / scale / self.study

    def jobs(self) -> list[Job]:
        """Return every job of the study, as far as finished runs determine them."""
        return [job for stage in STUDIES[self.study].stages(self.bench) for job in stage]

    def missing(self) -> list[Job]:
        """Return those of them that are to be done."""
        return self.bench.records.missing(self.jobs(), flown=STUDIES[self.study].flies)


def announce_all(plans: Sequence[Plan]) -> None:
    """Say what is missing of each of several studies, and how long all will take with what they share done once."""
    estimator = Estimator(plans[0].bench.records)
    for plan in plans:
        announce(plan, estimator)
    if len(plans) > 1:
        missing = list({job.digest: job for plan in plans for job in plan.missing()}.values())
        seconds, work = _length(missing, estimator, plans[0].at_once)
        work_left = f"{len(missing)} runs, those that studies share counted once: about {duration(seconds)}"
        plans[0].report(f"all: {work_left}, {duration(work)} of one core." if missing else "all: everything is there.")


def announce(plan: Plan, estimator: Estimator | None = None) -> float:
    """Say what is missing and how long that will take; return the seconds.

    Args:
        plan: what is to be done.
        estimator: one that may already know some kinds of run; a new one when None.
    """
    jobs = plan.jobs()
    missing = plan.missing()
    there = len({job.digest for job in jobs}) - len(missing)
    if missing:
        plan.report(
            f"{plan.study}: measuring first pieces of {len(missing)} runs that are missing ({there} are there) ..."
        )
    else:
        plan.report(f"{plan.study}: all {there} runs are there.")
    estimator = estimator or Estimator(plan.bench.records)
    estimator.learn(jobs)
    seconds, work = _length(missing, estimator, plan.at_once)
    if missing:
        plan.report(f"{plan.study}: about {duration(seconds)}, {plan.at_once} at a time, {duration(work)} of one core.")
    return seconds


def _length(missing: list[Job], estimator: Estimator, at_once: int) -> tuple[float, float]:
    """Return how long jobs take with so many processes at a time, and on one core, s."""
    took = [load.seconds for load in packed(missing, {job.digest: estimator.seconds(job) for job in missing})]
    return max(sum(took) / at_once, *took, 0.0), sum(took)


def carry_out(plan: Plan, stop: StopSignal) -> bool:
    """Do what is missing and write the results; return whether that was all, rather than stopped.

    Raises:
        EiaSecError: runs failed.
        RunDirError: the results cannot be written.
    """
    study, bench = STUDIES[plan.study], plan.bench
    estimator = Estimator(bench.records)
    runner = Runner(bench.records, plan.at_once, command(f"python -m {PROGRAM}", plan.arguments), plan.report)
    for number in range(len(study.stages(bench))):
        # What a later stage consists of follows from the earlier ones' results, so it is asked for only now.
        stage = study.stages(bench)[number]
        estimator.learn(stage)
        missing = bench.records.missing(stage, flown=study.flies)
        for job in missing:
            bench.records.forget(job)
        seconds = {job.digest: estimator.seconds(job) for job in missing}
        if missing and not runner.run(missing, seconds, stop):
            return False
    write(plan)
    return True


def write(plan: Plan) -> None:
    """Write results.json, pictures and README.md of a study whose jobs are all done; raise RunDirError if it cannot."""
    study, bench = STUDIES[plan.study], plan.bench
    origin = made_by(f"python -m {PROGRAM}", plan.arguments)
    data = {"study": plan.study, "scale": bench.scale.name, **origin, "sizes": sizes(bench), **study.summarise(bench)}
    save(plan, data)


def save(plan: Plan, data: dict[str, Any]) -> None:
    """Write a study's results, pictures and page; raise RunDirError if it cannot."""
    folder = plan.folder
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / RESULTS).write_text(json.dumps(data) + "\n", encoding="utf-8")
        pictures = save_pictures(data, folder)
        (folder / PAGE).write_text(page(STUDIES[plan.study].title, data, pictures), encoding="utf-8")
    except OSError as error:
        raise RunDirError(f"cannot write into {folder}: {error.strerror}.") from error
    plan.report(f"\n{SECTIONS[plan.study](data)}\nwritten to {folder}: {RESULTS}, {PAGE}, {', '.join(pictures)}")


def sizes(bench: Bench) -> dict[str, Any]:
    """Return the scale in the page's terms."""
    scale = bench.scale
    seeds = ("seeds", "side_seeds", "team_seeds")
    names = ("episodes", *seeds, "trial_episodes", "long_trial_episodes", "choice_farms")
    reported = {"first_farm": scale.reported.start, "farms": len(scale.reported)}
    return {**{name: getattr(scale, name) for name in names}, **reported, "paper_farm": scale.paper_farm}
