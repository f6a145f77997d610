"""What follows from a round: truncation, the elite team of each type, and hyperparameters inside their ranges."""

import numpy as np
import pytest

from eia_sec.common.config import EliteConfig, RunConfig
from eia_sec.common.config.files import from_toml
from eia_sec.common.reward_sums import RewardSums
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.elite.evaluation_plan import evaluation_plan, population_plan
from eia_sec.elite.rounds import drawn, perturbed, ranked

TEAM = TeamSpec((GroupSpec("a", 2, 3, 2), GroupSpec("b", 1, 3, 2)))
RANGES = {"actor_rate": (1e-4, 1e-2), "entropy_start": (1e-3, 0.1)}
CONFIG = from_toml(
    "[population]\nmembers = 4\nfarms = 3\n[population.hyperparameters]\nactor_rate = [1e-4, 1e-2]\n"
    "entropy_start = [1e-3, 0.1]\n",
    RunConfig(),
)


def earned(*means: float) -> RewardSums:
    """Return the rewards of agents that earn the same in each of ten steps, so that their variance is 0."""
    return RewardSums.of(np.tile(np.array(means, np.float32), (1, 10, 1)), 10)


def names(members: int) -> dict[str, RewardSums]:
    """Return members of which a later one earns more."""
    return {f"m{index}": earned(index, index, index) for index in range(members)}


@pytest.mark.parametrize(("members", "weak"), [(2, 1), (3, 1), (4, 1), (7, 1), (8, 2), (12, 3)])
def test_the_lowest_quarter_is_weak(members, weak):
    """At least one member, the weakest first."""
    ranking = ranked(TEAM, EliteConfig(), names(members))
    assert ranking.weak == tuple(f"m{index}" for index in range(weak))
    assert ranking.best == f"m{members - 1}"
    assert ranking.sources("m0") == (ranking.best, ranking.best)
    assert ranking.sources(ranking.best) == ("", "")


def test_each_type_has_an_elite_team_of_its_own():
    """A weak member imitates the best team of each type, and keeps the team of a type in which it is best itself."""
    rewards = {"x": earned(0.0, 1.0, 9.0), "y": earned(5.0, 6.0, 0.0), "z": earned(5.0, 5.0, 5.0)}
    ranking = ranked(TEAM, EliteConfig(), rewards)
    assert ranking.scores == pytest.approx({"x": 10 / 3, "y": 11 / 3, "z": 5.0})
    assert ranking.elites == (("y", 1), ("x", 0))
    assert (ranking.weak, ranking.best) == (("x",), "z")
    assert ranking.sources("x") == ("y", "")
    assert ranking.sources("y") == ("", "")


def test_members_that_score_alike_imitate_nobody():
    """There is nothing to gain."""
    assert ranked(TEAM, EliteConfig(), {"x": earned(1, 1, 1), "y": earned(1, 1, 1)}).weak == ()


def test_hyperparameters_are_multiplied_or_divided_inside_their_ranges():
    """Each by a draw of its own, which a restarted coordinator repeats."""
    values = {"actor_rate": 1e-3, "entropy_start": 0.095}
    found = [perturbed(CONFIG, values, number, "m1") for number in range(1, 40)]
    assert {round(one["actor_rate"], 9) for one in found} == {round(1e-3 * 1.2, 9), round(1e-3 / 1.2, 9)}
    assert {round(one["entropy_start"], 9) for one in found} == {0.1, round(0.095 / 1.2, 9)}
    assert any((one["actor_rate"] > 1e-3) != (one["entropy_start"] > 0.095) for one in found)
    assert perturbed(CONFIG, values, 7, "m1") == found[6]
    assert [perturbed(CONFIG, values, number, "m2") for number in range(1, 40)] != found


def test_members_begin_with_different_hyperparameters():
    """Member 0 with the configured ones, others with draws from the ranges that spread over the orders of magnitude."""
    assert drawn(CONFIG, 0) == {"actor_rate": 1e-3, "entropy_start": 0.02}
    found = [drawn(CONFIG, member) for member in range(1, 60)]
    for name, (low, high) in RANGES.items():
        values = [one[name] for one in found]
        assert low <= min(values) < low * 2 < high / 2 < max(values) <= high
    assert drawn(CONFIG, 5) == found[4]


def test_all_members_fly_the_same_episodes():
    """Those of a round follow from the population's seed, not from a member's, and differ from an event's."""
    other = from_toml("seed = 9", CONFIG)
    farms, episodes = population_plan(CONFIG, 2)
    assert (farms, episodes) == population_plan(other, 2)
    assert (len(set(farms)), len(set(episodes))) == (3, 3)
    assert population_plan(CONFIG, 3) != population_plan(CONFIG, 2)
    assert evaluation_plan(from_toml("[elite]\nfarms = 3", CONFIG.with_algorithm("eia-ppo")), 2)[1] != episodes
