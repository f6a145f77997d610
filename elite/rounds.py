"""What follows from a round of a population: who is weak, whom each type imitates, and with which hyperparameters.

Population-based training (Jaderberg et al. 2017) with truncation selection. A member's score is the mean omega of its
agents, a type's that of its agents. The elite team of a type is that of the member whose type scores highest, so a weak
member may imitate different members, and keeps the team of a type in which it is best itself.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from eia_sec.common.config import EliteConfig, RunConfig
from eia_sec.common.reward_sums import RewardSums
from eia_sec.common.seeds import stream
from eia_sec.common.team import TeamSpec
from eia_sec.elite.scoring import scores

WEAK_SHARE = 0.25
"""Share of the members that imitates in a round, at least one; that of the paper is 0.2."""


@dataclass(frozen=True)
class Ranking:
    """The members of a round by their scores.

    Attributes:
        scores: of each member.
        weak: the members that imitate, the weakest first.
        elites: for each type, the member whose team scores highest, and the index of its best agent.
    """

    scores: Mapping[str, float]
    weak: tuple[str, ...]
    elites: tuple[tuple[str, int], ...]

    @property
    def best(self) -> str:
        """The member with the highest score."""
        return max(self.scores, key=lambda name: self.scores[name])

    def sources(self, member: str) -> tuple[str, ...]:
        """Return for each type whom a member imitates; empty where nobody."""
        weak = member in self.weak
        return tuple(elite if weak and elite != member else "" for elite, _ in self.elites)


def weak_members(members: int) -> int:
    """Return how many of so many members imitate in a round, if not all score alike."""
    return max(1, int(WEAK_SHARE * members))


def ranked(team: TeamSpec, config: EliteConfig, rewards: Mapping[str, RewardSums]) -> Ranking:
    """Return the ranking of members that were evaluated on the same episodes.

    Args:
        team: the layout.
        config: beta_1 and beta_2 of omega.
        rewards: of each member, of one step or more.
    """
    omegas = {name: scores(team, found, config) for name, found in sorted(rewards.items())}
    whole = {name: float(np.concatenate(omega).mean()) for name, omega in omegas.items()}
    order = sorted(whole, key=lambda name: whole[name])
    best = whole[order[-1]]
    weak = tuple(name for name in order[: weak_members(len(order))] if whole[name] < best)
    elites = []
    for kind in range(len(team.groups)):
        elite = max(omegas, key=lambda name: float(omegas[name][kind].mean()))
        elites.append((elite, int(np.argmax(omegas[elite][kind]))))
    return Ranking(whole, weak, tuple(elites))


def perturbed(config: RunConfig, values: Mapping[str, float], number: int, member: str) -> dict[str, float]:
    """Return hyperparameters, each multiplied or divided by the perturbation and kept inside its range.

    Args:
        config: the run.
        values: those that are taken over.
        number: the round, which with the member and the population's seed determines the draws.
        member: who takes them over.
    """
    random, factor = stream(config.population.seed, "perturbation", number, member), config.population.perturbation
    found = {}
    for name, (low, high) in config.population.hyperparameters.items():
        value = values[name] * (factor if random.random() < 0.5 else 1.0 / factor)
        found[name] = float(min(high, max(low, value)))
    return found


def drawn(config: RunConfig, member: int) -> dict[str, float]:
    """Return the hyperparameters with which a member begins: the configured ones, or drawn from their ranges."""
    ranges = config.population.hyperparameters
    if member == 0:
        return {name: float(getattr(config.algorithm, name)) for name in ranges}
    random = stream(config.population.seed, "hyperparameters", member)
    found = {name: float(np.exp(random.uniform(np.log(low), np.log(high)))) for name, (low, high) in ranges.items()}
    return {name: min(ranges[name][1], max(ranges[name][0], value)) for name, value in found.items()}
