"""What `eia-sec reproduce` does: say how long it takes, do what is missing, write data, pictures and a page."""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from common.errors import RunDirError
from common.process import StopSignal
from deploy.provenance import command, made_by
from deploy.studies.bench import Bench
from deploy.studies.catalogue import STUDIES
from deploy.studies.estimate import Estimator
from deploy.studies.flight_pictures import save_flights
from deploy.studies.pictures import RESULTS, save_pictures
from deploy.studies.runner import Runner, duration, packed
from deploy.studies.scales import FULL
from deploy.studies.tables import SECTIONS, page

PAGE: Final = "README.md"


@dataclass(frozen=True)
class Plan:
    """What is to be done.

    Attributes:
        study: the study's name.
        bench: its scale and records.
        write: folder for the folders of all studies.
        at_once: processes at a time.
        arguments: the command line behind `eia-sec`, for the record.
        tell: takes each line for the user.
    """

    study: str
    bench: Bench
    write: Path
    at_once: int
    arguments: Sequence[str]
    tell: Callable[[str], None]

    @property
    def folder(self) -> Path:
        """Return the study's own folder; a smoke run's lies apart, so that it never takes the place of a full one's."""
        scale = self.bench.scale.name
        return self.write / self.study if scale == FULL.name else self.write / scale / self.study


def announce(plan: Plan) -> float:
    """Say what is missing and how long that will take; return the seconds."""
    study = STUDIES[plan.study]
    jobs = [job for stage in study.stages(plan.bench) for job in stage]
    missing = plan.bench.records.missing(jobs, flown=study.flies)
    there = len({job.digest for job in jobs}) - len(missing)
    if missing:
        plan.tell(
            f"{plan.study}: measuring first pieces of {len(missing)} runs that are missing ({there} are there) ..."
        )
    else:
        plan.tell(f"{plan.study}: all {there} runs are there.")
    estimator = Estimator(plan.bench.records)
    estimator.learn(jobs)
    loads = packed(missing, {job.digest: estimator.seconds(job) for job in missing})
    took = [load.seconds for load in loads]
    seconds = max(sum(took) / plan.at_once, *took, 0.0)
    if missing:
        plan.tell(
            f"{plan.study}: about {duration(seconds)}, {plan.at_once} at a time, {duration(sum(took))} of one core."
        )
    return seconds


def carry_out(plan: Plan, stop: StopSignal) -> bool:
    """Do what is missing and write the results; return whether that was all, rather than stopped.

    Raises:
        EiaSecError: runs failed.
        RunDirError: the results cannot be written.
    """
    study, bench = STUDIES[plan.study], plan.bench
    estimator = Estimator(bench.records)
    runner = Runner(bench.records, plan.at_once, command("eia-sec", plan.arguments), plan.tell)
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
    study, bench, folder = STUDIES[plan.study], plan.bench, plan.folder
    origin = made_by("eia-sec", plan.arguments)
    data = {"study": plan.study, "scale": bench.scale.name, **origin, "sizes": sizes(bench), **study.summarise(bench)}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / RESULTS).write_text(json.dumps(data) + "\n", encoding="utf-8")
        pictures = draw(plan.study, data, bench, folder)
        (folder / PAGE).write_text(page(study.title, data, pictures), encoding="utf-8")
    except OSError as error:
        raise RunDirError(f"cannot write into {folder}: {error.strerror}.") from error
    plan.tell(f"\n{SECTIONS[plan.study](data)}\nwritten to {folder}: {RESULTS}, {PAGE}, {', '.join(pictures)}")


def draw(study: str, data: dict[str, Any], bench: Bench, folder: Path) -> list[str]:
    """Draw a study's pictures; return the files' names."""
    return save_flights(bench, folder) if study == "trajectories" else save_pictures(data, folder)


def sizes(bench: Bench) -> dict[str, Any]:
    """Return what the scale comes to, as the page needs it."""
    scale = bench.scale
    seeds = ("seeds", "side_seeds", "team_seeds")
    names = ("episodes", *seeds, "trial_episodes", "long_trial_episodes", "farms", "choice_farms")
    return {**{name: getattr(scale, name) for name in names}, "paper_farm": scale.paper_farm}
