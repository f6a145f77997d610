"""What a benchmark consists of, and whether all of it is possible."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from eia_sec.common import plugins
from eia_sec.common.config import RunConfig
from eia_sec.common.config.checks import within
from eia_sec.common.environment import EnvironmentSpec
from eia_sec.common.errors import ConfigError, UsageError
from eia_sec.deploy.benchmark.trainings import RANDOM, Measuring, Training
from eia_sec.deploy.local.environment_trial import tried
from eia_sec.rollout.envs.registry import environment_spec

MOST_SEEDS: Final = 1000


@dataclass(frozen=True)
class Plan:
    """Trainings of several algorithms on several environments over the same seeds.

    Attributes:
        algorithms: their names, in the order of tables.
        environments: likewise.
        seeds: how many, from 0 on.
        trainings: of every algorithm, environment and seed; those of one seed stand together.
        references: random actions in each environment.
    """

    algorithms: tuple[str, ...]
    environments: tuple[str, ...]
    seeds: int
    trainings: tuple[Training, ...]
    references: tuple[Training, ...]

    @classmethod
    def of(cls, bases: Sequence[RunConfig], algorithms: Sequence[str], seeds: int, measuring: Measuring) -> "Plan":
        """Return the plan for environments, each with what its runs begin from.

        Raises:
            UsageError: something cannot be trained or compared.
        """
        within(1, MOST_SEEDS, seeds=seeds)
        trainings, references = [], []
        for base in bases:
            _require_comparable(base, measuring)
            references.append(Training(RANDOM, replace(base, seed=0), measuring))
        for seed in range(seeds):
            for base in bases:
                for name in algorithms:
                    trainings.append(Training(name, replace(base.with_algorithm(name), seed=seed), measuring))
        names = tuple(base.env.name for base in bases)
        tasks = [task_of(name) for name in names]
        if len(set(tasks)) < len(tasks):
            raise UsageError(f"two of the environments {', '.join(names)} have one name in the results.")
        return cls(tuple(algorithms), names, seeds, tuple(trainings), tuple(references))

    @property
    def all(self) -> tuple[Training, ...]:
        """References and trainings."""
        return (*self.references, *self.trainings)

    def of_algorithm(self, algorithm: str, environment: str) -> list[Training]:
        """Return the trainings of an algorithm on an environment, by seed."""
        found = (one for one in self.trainings if one.config.env.name == environment)
        return [one for one in found if one.algorithm == algorithm]

    def require_possible(self) -> None:
        """Try every environment, and every algorithm on it.

        Raises:
            UsageError: one cannot be trained.
            SystemExit: the trial of an environment in a process of its own has said what is wrong.
        """
        # Importing torch takes seconds, and what is wrong with names and numbers is known before.
        from eia_sec.learner.registry import require_algorithm  # noqa: PLC0415  (see above)
        from eia_sec.learner.trainers import make_trainer  # noqa: PLC0415  (see above)

        for environment in self.environments:
            specs: dict[tuple[bool, bool], EnvironmentSpec] = {}
            for algorithm in self.algorithms:
                config = self.of_algorithm(algorithm, environment)[0].config
                if config.plugins:
                    require_algorithm(config.algorithm)
                    plugins.check_callbacks(config.plugins)
                acts = config.algorithm.discrete_actions, config.algorithm.continuous_actions
                if acts not in specs:  # which of its actions an environment offers depends on what is trained
                    specs[acts] = tried(config) if config.env.is_third_party else environment_spec(config)
                spec = specs[acts]
                config.algorithm.require_types(spec.team.types)
                make_trainer(config, spec.team)


def task_of(environment: str) -> tuple[str, str]:
    """Return the names of an environment and its task, in small letters, as marl-eval expects them."""
    module, _, member = environment.lower().rpartition(":")
    return (module, member) if module else ("eia-sec", member)


def _require_comparable(base: RunConfig, measuring: Measuring) -> None:
    """Raise UsageError where runs cannot be compared at equal steps."""
    if base.env.served:
        raise UsageError(f"{base.env.name} is served by others; a benchmark makes its environments itself.")
    if not base.steps:
        raise ConfigError(f"runs on {base.env.name} end by episodes; give --steps, so that all take equally many.")
    chunk = base.rollout.environments * base.rollout.chunk_steps
    if chunk * measuring.points > base.steps:
        most = base.steps // chunk
        few = f"--points may be {most:,} at most" if most else f"--steps must be {chunk:,} at least"
        raise UsageError(f"policies change once in {chunk:,} steps of {base.env.name}, so {few}.")
