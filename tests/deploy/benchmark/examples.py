"""Plans and results for tests of benchmarks."""

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import with_values
from eia_sec.common.config.presets import preset
from eia_sec.deploy.benchmark.plan import Plan
from eia_sec.deploy.benchmark.records import Point, Result
from eia_sec.deploy.benchmark.trainings import Measuring

COVER = "mytask.env:Cover"
MEASURING = Measuring(points=2, scenarios=2)
MADE = {"commit": "abc1234", "python": "3.11.9", "packages": {"torch": "2.6.0"}}
SMALL = {
    "steps": 800,
    "algorithm.hidden": 16,
    "algorithm.iteration_steps": 200,
    "algorithm.minibatch_steps": 100,
    "algorithm.epochs": 1,
    "rollout.environments": 2,
    "rollout.chunk_steps": 100,
}


def base(environment: str = COVER, **changes: object) -> RunConfig:
    """Return what small runs begin from."""
    return with_values(preset("generic").with_environment(environment), {**SMALL, **changes})


def plan(*environments: str, algorithms: tuple[str, ...] = ("ippo", "mappo"), seeds: int = 2) -> Plan:
    """Return a plan of small runs."""
    return Plan.of([base(name) for name in environments or (COVER,)], algorithms, seeds, MEASURING)


def result(*means: float, last: float = 0.0, best: float = 0.0, sampled: float | None = None) -> Result:
    """Return a result with two equal returns at each point, and equal ones at the end."""
    points = [Point(400 * (at + 1), 1.0 + at, [mean, mean]) for at, mean in enumerate(means)]
    return Result(points, [best] * 20, [last] * 20, [] if sampled is None else [sampled] * 20, MADE)
