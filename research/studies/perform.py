"""Does one job of a study inside this process.

Training runs without Zenoh: `eia_sec.deploy.local.in_process.train_in_process` has the mathematics of the distributed
run, bit for bit (tests/system/test_lockstep.py), and needs one process where that needs three.
"""

import errno
import math
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

import numpy as np
import torch

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import RunConfig
from eia_sec.common.errors import EiaSecError, PolicyError, RunDirError, SchemaError
from eia_sec.common.log import log
from eia_sec.common.policy_file import save_policy
from eia_sec.common.process import StopSignal
from eia_sec.common.team import TeamSpec
from eia_sec.common.transitions import Chunk, EpisodeSummary
from eia_sec.deploy.local.in_process import train_in_process
from eia_sec.deploy.local.process_queue import PROGRESS
from eia_sec.deploy.reports.provenance import commit
from eia_sec.learner.trainer import Trainer
from eia_sec.rollout.envs.registry import environment_spec
from eia_sec.rollout.evaluation import Evaluation, evaluate
from eia_sec.rollout.policies import ActorPolicy, policy_of
from research.studies.jobs import POLICY_SUFFIX, Job, Records
from research.studies.methods import MIXTURE
from research.studies.record_checks import COUNTERS
from research.studies.timing import time_decisions

NO_ROOM: Final = frozenset((errno.ENOSPC, errno.EDQUOT))
"""What a disk says on which there may be room later."""
ROOM_SECONDS: Final = 1.0
"""Pause before it is tried again to write onto a disk that was full."""
DIVERGED: Final = 1e6
"""A critic loss beyond this, in units of scaled reward squared, counts as diverged; such a run is cut short."""
DIGITS: Final = 4
"""Decimals that records keep."""


class StoppedError(EiaSecError):
    """The run was stopped; it leaves no record."""


class _DivergedError(Exception):
    """Ends a run whose critics have left all bounds."""


def perform(job: Job, records: Records, command: str, report: Callable[[float], None] = lambda share: None) -> None:
    """Do a job and write its record.

    Args:
        job: what to do.
        records: where the record goes.
        command: the command line, for the record.
        report: called with the share that is done; what it raises ends the job.

    Raises:
        StoppedError: `report` raised it.
        EiaSecError: the job cannot be done.
    """
    torch.set_num_threads(job.config.learner.threads)
    made = {"command": command, "commit": commit()}
    actors: TeamActors | None = None
    start = time.monotonic()
    if job.kind == "train":
        result, actors = train(job.config, job.options, report)
    elif job.kind == "fly":
        result = fly(job.config, job.options)
    else:
        result = time_decisions(job.config, int(job.options["steps"]))
    seconds = time.monotonic() - start
    if actors is not None:
        metadata = {**made, "seed": str(job.config.seed), "job": job.digest}
        kept(partial(save_policy, records.path(job, POLICY_SUFFIX), actors, metadata), report)
    kept(lambda: records.put(job, made, seconds, result), report)


def kept(write: Callable[[], object], report: Callable[[float], None]) -> None:
    """Write what may not be lost; on a full disk wait until there is room, or until `report` raises."""
    waiting = False
    while True:
        try:
            write()
        except (PolicyError, RunDirError) as error:
            if not isinstance(error.__cause__, OSError) or error.__cause__.errno not in NO_ROOM:
                raise
            if not waiting:
                log(f"{error} It waits for room.")
            waiting = True
            report(1.0)
            time.sleep(ROOM_SECONDS)
        else:
            return


def perform_all(jobs: Sequence[Job], records: Records, command: str) -> None:
    """Do jobs one after another in a process of their own, reporting progress on standard output.

    Jobs that have a record are left out, so that a process that is started again goes on.

    Raises:
        StoppedError: a signal came, or the process that started this one is gone.
    """
    stop = StopSignal()
    stop.install()
    try:
        for number, job in enumerate(jobs):

            def report(share: float, number: int = number) -> None:
                if stop:
                    raise StoppedError("stopped before it was done.")
                with suppress(OSError):  # a full disk costs the line, and not the training
                    sys.stdout.write(f"{PROGRESS} {(number + share) / len(jobs):.4f}\n")
                    sys.stdout.flush()

            report(0.0)
            if records.get(job) is None:
                perform(job, records, command, report)
    finally:
        stop.uninstall()


def fly(config: RunConfig, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the evaluation of a policy that learns nothing; `options`: policy, farms."""
    name = str(options["policy"])
    return compact(evaluate(config.farm, policy_of(name, config.farm), farms_of(options["farms"]), 1, name=name))


def train(
    config: RunConfig, options: Mapping[str, Any], report: Callable[[float], None]
) -> tuple[dict[str, Any], TeamActors]:
    """Train a run; return its result and its actors without noise.

    Args:
        config: the run.
        options: `farms` and `choice_farms` as first and number, `points` of the curve, `evaluations` on the way.
        report: called after each chunk with the share that is done.
    """
    log = _Log(config, farms_of(options["choice_farms"]), int(options["evaluations"]), report)
    diverged = False
    try:
        trainer = train_in_process(config, log.watch)
        log.note(trainer)
    except (_DivergedError, SchemaError) as error:
        # Actors that are not finite are refused as SchemaError; where no loss had grown, it is another fault.
        if isinstance(error, SchemaError) and "finite" not in str(error):
            raise
        diverged = True
    farms = farms_of(options["farms"])
    final = evaluate(config.farm, ActorPolicy(log.actors), farms, 1, name=config.algorithm.name)
    result = {
        "diverged": diverged,
        "compared_value": MIXTURE,
        "curve": curve(environment_spec(config).team, log.episodes, int(options["points"])),
        "checks": log.checks,
        "evaluation": compact(final),
        **log.counts,
    }
    return result, log.actors


@dataclass
class _Log:
    """What is noted while a run trains.

    Attributes:
        config: the run.
        farms: farms of the noise-free evaluations on the way.
        wanted: how many of them.
        report: called with the share that is done.
        actors: the newest noise-free actors whose numbers were finite; at first those that nothing has trained.
    """

    config: RunConfig
    farms: range
    wanted: int
    report: Callable[[float], None]
    episodes: list[EpisodeSummary] = field(default_factory=list)
    checks: list[dict[str, float]] = field(default_factory=list)
    counts: dict[str, Any] = field(default_factory=lambda: dict.fromkeys(COUNTERS, 0))

    def __post_init__(self) -> None:
        """Begin with fresh actors, so that a run that diverges at once has some."""
        self.actors = TeamActors.initial(
            environment_spec(self.config).team, self.config.algorithm.hidden, self.config.seed
        )

    def watch(self, trainer: Trainer, chunk: Chunk) -> None:
        """Note a chunk's episodes; evaluate when it is time; raise when the critics have left all bounds."""
        self.report(min(1.0, trainer.environment_steps / (self.config.episodes * self.config.farm.world.steps)))
        self.counts |= {name: getattr(trainer, name) for name in COUNTERS}
        self.actors = trainer.actors().noise_free()
        if not chunk.episodes:
            return
        self.episodes += chunk.episodes
        self.counts |= compared(trainer)
        losses = [value for key, value in trainer.statistics().items() if key.startswith("critic_loss")]
        if any(not loss <= DIVERGED for loss in losses):
            raise _DivergedError
        if trainer.episodes * self.wanted >= (len(self.checks) + 1) * self.config.episodes:
            self.note(trainer)

    def note(self, trainer: Trainer) -> None:
        """Evaluate the present actors without noise, unless that was just done."""
        if self.checks and self.checks[-1]["episodes"] == trainer.episodes:
            return
        score = evaluate(self.config.farm, ActorPolicy(self.actors), self.farms, 1, name="").total
        named = {"reward": score.reward, "aoi": score.metrics["aoi"], "vdf": score.metrics["vdf"]}
        self.checks.append({"episodes": trainer.episodes, **{name: round(v, DIGITS) for name, v in named.items()}})


def compared(trainer: Trainer) -> dict[str, dict[str, float]]:
    """Return for each type the realised returns and how far the critics stand above them, units of the targets."""
    statistics = {key: value for key, value in trainer.statistics().items() if math.isfinite(value)}
    return {
        name: {key.partition("/")[2]: round(value, DIGITS) for key, value in statistics.items() if key.startswith(name)}
        for name in ("overestimation", "realised_return")
    }


def curve(team: TeamSpec, episodes: Sequence[EpisodeSummary], points: int) -> dict[str, Any]:
    """Return a training curve: means over equal shares of the finished episodes.

    Returns:
        `episodes` finished at the end of each share; `reward` of all agents under mean and of each type; aoi, vdf.
    """
    shares = np.array_split(np.arange(len(episodes)), max(1, min(points, len(episodes))))
    reward = np.array([episode.reward for episode in episodes], np.float64).reshape(len(episodes), team.agents)
    columns = {"mean": reward.mean(axis=1)} | {
        group.name: reward[:, agents].mean(axis=1)
        for group, agents in zip(team.groups, team.agent_slices(), strict=True)
    }
    levels = {name: np.array([episode.metrics[name] for episode in episodes]) for name in ("aoi", "vdf")}

    def binned(values: Any) -> list[float]:
        return [round(float(values[share].mean()), DIGITS) for share in shares if share.size]

    return {
        "episodes": [int(share[-1]) + 1 for share in shares if share.size],
        "reward": {name: binned(values) for name, values in columns.items()},
        **{name: binned(values) for name, values in levels.items()},
    }


def compact(evaluation: Evaluation) -> dict[str, Any]:
    """Return an evaluation as a record keeps it: one list over the farms for each figure."""
    scores = evaluation.per_farm
    return {
        "first_farm": evaluation.farms[0],
        "farms": len(evaluation.farms),
        "reward": [round(score.reward, DIGITS) for score in scores],
        "types": {name: [round(score.types[name], DIGITS) for score in scores] for name in scores[0].types},
        "metrics": {name: [round(score.metrics[name], DIGITS) for score in scores] for name in scores[0].metrics},
    }


def farms_of(pair: Any) -> range:
    """Return the farms that a pair of first and number names."""
    first, count = (int(number) for number in pair)
    return range(first, first + count)
