"""The scores of a benchmark: arrays over seeds and environments, and marl-eval's layout of them."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from eia_sec.deploy.benchmark.plan import Plan, task_of
from eia_sec.deploy.benchmark.records import Result
from eia_sec.deploy.benchmark.trainings import Training
from eia_sec.deploy.reports.intervals import Interval, Numbers, stratified_interval

METRIC: Final = "return"
"""Name of the reward per agent and episode in marl-eval's layout."""

Returns = Callable[[Result], list[float]]


def final(result: Result) -> list[float]:
    """Return the returns of the policy at the end."""
    return result.final


def absolute(result: Result) -> list[float]:
    """Return those of the best policy of all points."""
    return result.absolute


def sampled(result: Result) -> list[float]:
    """Return those of the policy at the end by drawn actions."""
    return result.sampled


@dataclass(frozen=True)
class Scores:
    """The results of all trainings of a plan.

    Attributes:
        plan: the plan.
        results: by name of the training.
    """

    plan: Plan
    results: Mapping[str, Result]

    def result(self, training: Training) -> Result:
        """Return a training's result."""
        return self.results[training.name]

    def by_seed(self, algorithm: str, environment: str) -> list[Result]:
        """Return the results of an algorithm on an environment, by seed."""
        return [self.result(one) for one in self.plan.of_algorithm(algorithm, environment)]

    def interval(self, algorithm: str, environment: str, returns: Returns) -> Interval | None:
        """Return the interquartile mean over the seeds of mean returns; None where a seed has none."""
        each = [returns(result) for result in self.by_seed(algorithm, environment)]
        return stratified_interval(np.array([[np.mean(one)] for one in each])) if all(each) else None

    def normalised(self, algorithm: str, returns: Returns) -> Interval:
        """Return the interquartile mean over seeds and environments of mean returns on the scale of `bounds`."""
        columns = []
        for environment in self.plan.environments:
            low, high = self.bounds(environment)
            means = [float(np.mean(returns(result))) for result in self.by_seed(algorithm, environment)]
            columns.append((np.array(means) - low) / (high - low if high > low else 1.0))
        return stratified_interval(np.stack(columns, axis=1))

    def bounds(self, environment: str) -> tuple[float, float]:
        """Return the lowest and the highest return of an episode of any algorithm, which marl-eval scales by."""
        ends = []
        for algorithm in self.plan.algorithms:
            for result in self.by_seed(algorithm, environment):
                held = np.concatenate([*(point.returns for point in result.points), result.absolute])
                ends.append((held.min(), held.max()))
        lows, highs = zip(*ends, strict=True)
        return float(min(lows)), float(max(highs))

    def curve(self, algorithm: str, environment: str) -> tuple[Numbers, Numbers]:
        """Return steps [P], means over the seeds, and interquartile mean with interval [3, P] at all points."""
        seeds = self.by_seed(algorithm, environment)
        steps = np.array([[point.step_count for point in one.points] for one in seeds], np.float64).mean(axis=0)
        returns = np.array([[np.mean(point.returns) for point in one.points] for one in seeds], np.float64)
        found = [stratified_interval(column[:, None]) for column in returns.T]
        return steps, np.array(found).T

    def random(self, environment: str) -> float:
        """Return the mean return of random actions on the final scenarios."""
        (one,) = (one for one in self.plan.references if one.config.env.name == environment)
        return float(np.mean(self.result(one).final))

    def marl_eval(self) -> dict[str, Any]:
        """Return all returns in the layout of marl-eval: environment, task, algorithm, seed, step."""
        found: dict[str, Any] = {}
        for environment in self.plan.environments:
            module, task = task_of(environment)
            found.setdefault(module, {})[task] = {
                algorithm: {
                    f"seed_{seed}": _steps(result) for seed, result in enumerate(self.by_seed(algorithm, environment))
                }
                for algorithm in self.plan.algorithms
            }
        return found


def _steps(result: Result) -> dict[str, Any]:
    """Return a seed's evaluations in marl-eval's layout; what it calls absolute stands last."""
    along = {
        f"step_{number}": {"step_count": point.step_count, METRIC: point.returns}
        for number, point in enumerate(result.points)
    }
    return {**along, "absolute_metrics": {METRIC: result.absolute}}
