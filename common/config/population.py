"""A population of learners: when its members are compared, and what weak ones take over from strong ones."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from eia_sec.common.config.checks import positive, within
from eia_sec.common.config.maps import FrozenMap, freeze
from eia_sec.common.errors import ConfigError

MOST_MEMBERS: Final = 64


@dataclass(frozen=True)
class PopulationConfig:
    """Population-based training (Jaderberg et al. 2017): learners of one task that imitate the best of them."""

    members: int = 0
    """Learners of the population, each with workers of its own; 0 for a run alone. `--population` is short for it."""
    seed: int = 0
    """Seed of what members share, which are initial networks, evaluation episodes and the draws of hyperparameters;
    `eia-sec train` sets it to the run's, and gives each member a seed of its own."""
    interval: float = 0.1
    """Share of the run between two rounds, in which all members are scored and weak ones imitate."""
    farms: int = 8
    """Noise-free evaluation episodes of each member in a round, each on a different training farm, so at most
    `rollout.train_farms`."""
    rate: float = 1.0
    """Share by which a weak member's actors move to those of the elite team of their type; 1 copies them."""
    perturbation: float = 1.2
    """Factor by which each hyperparameter that a weak member takes over is multiplied or divided, 1 for neither."""
    hyperparameters: Mapping[str, tuple[float, ...]] = FrozenMap()
    """Options of the algorithm that members differ in: the lowest and the highest value of each. Member 0 begins with
    the configured values, and the others draw theirs from the ranges, uniformly in the logarithm."""

    def __post_init__(self) -> None:
        """Refuse impossible populations and ranges."""
        within(0, MOST_MEMBERS, members=self.members)
        within(0, 2**63 - 1, seed=self.seed)
        within(0.001, 1.0, interval=self.interval)
        within(1, 256, farms=self.farms)
        within(0.0, 1.0, rate=self.rate)
        within(1.0, 10.0, perturbation=self.perturbation)
        freeze(self, "hyperparameters")
        if self.members == 1:
            raise ConfigError("members must be 2 or more, or 0 for a run alone.")
        for name, limits in self.hyperparameters.items():
            if len(limits) != 2 or not limits[0] <= limits[1]:
                raise ConfigError(f"hyperparameters.{name} must be the lowest and the highest value, not {limits}.")
            positive(**{f"hyperparameters.{name}": limits[0], f"hyperparameters.{name}, at most": limits[1]})
