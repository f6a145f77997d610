"""Does one training of a benchmark inside this process, and evaluates it along the way."""

import platform
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import RunConfig
from eia_sec.common.errors import CancelledError
from eia_sec.common.policy_file import save_policy
from eia_sec.common.process import StopSignal
from eia_sec.common.transitions import Chunk
from eia_sec.deploy.benchmark.records import POLICY, Point, Records, Result
from eia_sec.deploy.benchmark.trainings import RANDOM, Training
from eia_sec.deploy.local.in_process import train_in_process
from eia_sec.deploy.local.process_queue import PROGRESS
from eia_sec.deploy.progress import part
from eia_sec.deploy.reports.provenance import versions
from eia_sec.learner.trainer import Trainer
from eia_sec.rollout.envs.base import Environments
from eia_sec.rollout.evaluation import evaluate_run
from eia_sec.rollout.heuristics.random import RandomPolicy
from eia_sec.rollout.policies import ActorPolicy, BatchPolicy, SampledPolicy

TRAINING_SHARE: Final = 0.9
"""Share of the work that is training, in what is reported."""


def measured(training: Training, records: Records) -> None:
    """Do a training in a process of its own and write policy and record, unless the record is there.

    Raises:
        CancelledError: a signal came, or the process that started this one is gone; nothing is written.
    """
    if records.get(training) is not None:
        return
    stop = StopSignal()
    stop.install()

    def report(share: float) -> None:
        if stop:
            raise CancelledError("stopped before it was done.")
        with suppress(OSError):  # a full disk costs the line, and not the training
            sys.stdout.write(f"{PROGRESS} {share:.4f}\n")
            sys.stdout.flush()

    try:
        result, actors = measure(training, report)
        if actors is not None:
            metadata = {"algorithm": training.algorithm, "seed": str(training.config.seed), "training": training.digest}
            save_policy(records.path(training, POLICY), actors, metadata)
        records.put(training, result)
    finally:
        stop.uninstall()


def measure(
    training: Training, report: Callable[[float], None] = lambda share: None
) -> tuple[Result, TeamActors | None]:
    """Train and evaluate.

    Args:
        training: what to do.
        report: called after each chunk, and during evaluations, with the share that is done; what it raises ends all.

    Returns:
        the result, and the actors at the end; None for the reference.
    """
    config, scenarios = training.config, training.measuring.final(training.config)
    made = {**versions(), "processor": platform.processor() or platform.machine()}
    if training.algorithm == RANDOM:
        returns = _returns(config, RandomPolicy(), scenarios, report)
        return Result([], returns, returns, [], made), None
    course = _Course(training, report)
    trainer = train_in_process(config, course.watch)
    seconds = course.seconds()
    actors = trainer.actors()
    calm = actors.noise_free()
    policies: dict[str, BatchPolicy[Environments]] = {"final": ActorPolicy(calm)}
    if course.best.digest() != calm.digest():
        policies["absolute"] = ActorPolicy(course.best)
    if actors.draws:
        policies["sampled"] = SampledPolicy(actors)
    found = {}
    for done, (name, policy) in enumerate(policies.items()):
        tell = part(lambda share: report(TRAINING_SHARE + share * (1.0 - TRAINING_SHARE)), done, len(policies))
        found[name] = _returns(config, policy, scenarios, tell)
    absolute, sampled = found.get("absolute", found["final"]), found.get("sampled", [])
    return Result(course.points, absolute, found["final"], sampled, {**made, "seconds": round(seconds, 3)}), actors


class _Course:
    """What is noted while a run trains.

    Attributes:
        points: the evaluations so far.
        best: the actors of that with the highest mean return.
    """

    def __init__(self, training: Training, report: Callable[[float], None]) -> None:
        self._config, self._measuring, self._report = training.config, training.measuring, report
        self._began, self._evaluating, self._share = time.monotonic(), 0.0, 0.0
        self.points: list[Point] = []
        self.best: TeamActors
        self._highest = float("-inf")

    def seconds(self) -> float:
        """Return how long it has trained, without evaluations."""
        return time.monotonic() - self._began - self._evaluating

    def watch(self, trainer: Trainer, chunk: Chunk) -> bool:
        """Evaluate when it is time; return whether the steps are used up, those of imitation's evaluations included."""
        steps, budget, points = trainer.environment_steps + trainer.evaluation_steps, self._config.steps, self.points
        self._share = TRAINING_SHARE * min(1.0, steps / budget)
        self._report(self._share)
        due = min(self._measuring.points, steps * self._measuring.points // budget)
        if due > len(points):
            found = self._evaluated(trainer, steps)
            points += [found] * (due - len(points))
        return steps >= budget

    def _evaluated(self, trainer: Trainer, steps: int) -> Point:
        seconds, began = self.seconds(), time.monotonic()
        actors = trainer.actors().noise_free()
        scenarios = self._measuring.along(self._config)
        returns = _returns(self._config, ActorPolicy(actors), scenarios, lambda share: self._report(self._share))
        if (mean := sum(returns) / len(returns)) >= self._highest:
            self._highest, self.best = mean, actors
        self._evaluating += time.monotonic() - began
        return Point(steps, seconds, returns)


def _returns(
    config: RunConfig, policy: BatchPolicy[Environments], scenarios: range, tell: Callable[[float], None]
) -> list[float]:
    """Return the reward per agent of one episode on each scenario; `tell` hears the share that is done."""
    found = evaluate_run(config, policy, scenarios, 1, name="", tell=tell)
    return [score.reward for score in found.per_farm]
