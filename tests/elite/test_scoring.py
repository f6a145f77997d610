"""omega rewards a high and steady reward, and the elite is its type's best."""

import numpy as np
import pytest
from numpy.typing import NDArray

from eia_sec.common.config import EliteConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import SchemaError
from eia_sec.common.reward_sums import MOST_STEPS, RewardSums
from eia_sec.common.team import Float32, GroupSpec, TeamSpec
from eia_sec.elite.evaluation_plan import evaluation_plan
from eia_sec.elite.scoring import decide, scores

TEAM = TeamSpec((GroupSpec("a", 3, 4, 2), GroupSpec("b", 2, 5, 1)))


def scored(reward: Float32) -> NDArray[np.float64]:
    """Return omega of the agents of a team's one type from their step rewards [F, T, n]."""
    team = TeamSpec((GroupSpec("one", reward.shape[-1], 3, 2),))
    return scores(team, RewardSums.of(reward, reward.shape[0] * reward.shape[1]), EliteConfig())[0]


def test_scores_by_hand() -> None:
    """Omega = beta_1 mu + beta_2 sigma^2 of the rewards over their mean absolute value."""
    reward = np.array([[[1.0, 4.0], [3.0, 0.0]]], np.float32)
    wanted = [2.0 - 0.1 * 0.25, 2.0 - 0.1 * 1.0]
    np.testing.assert_allclose(scored(reward), wanted)


def test_the_steadier_of_two_equals_wins() -> None:
    """At equal means the lower variance has the higher omega."""
    reward = np.array([[[2.0, 0.0], [2.0, 4.0]]], np.float32)
    steady, wild = scored(reward)
    assert steady > wild


def test_scale_does_not_matter_to_the_variance() -> None:
    """A type with rewards a hundred times as large has the same spread in omega relative to its scale."""
    reward = np.random.default_rng(0).normal(1.0, 1.0, (2, 50, 3)).astype(np.float32)
    spread = [scored(each) - each.mean(axis=(0, 1)) for each in (reward, reward * np.float32(64))]
    np.testing.assert_allclose(*spread, rtol=1e-3)


def test_zero_rewards_have_zero_scores() -> None:
    """No reward at all divides by nothing."""
    np.testing.assert_array_equal(scored(np.zeros((1, 5, 2), np.float32)), [0.0, 0.0])


def test_decide_picks_each_types_best() -> None:
    """The elite's index is counted inside its type, and the evaluation's steps are counted."""
    reward = np.zeros((2, 10, 5), np.float32)
    reward[:, :, 2] = 1.0
    reward[:, :, 3] = 1.0
    event = decide(TEAM, EliteConfig(), 2, 7, 20, RewardSums.of(reward, 20), 20)
    assert (event.elites, event.rate, event.version, event.evaluation_steps) == ((2, 0), 0.05, 7, 20)
    event.check(TEAM)


def test_no_steps_decide_nothing() -> None:
    """Without a step there is no score."""
    with pytest.raises(SchemaError):
        decide(TEAM, EliteConfig(), 1, 1, 10, RewardSums.none(5))


def test_sums_equal_those_of_all_steps() -> None:
    """Scores from sums of chunks, with rows that no step follows, are those of all steps at once."""
    reward = np.random.default_rng(1).normal(1.0, 2.0, (40, 5)).astype(np.float32)
    padded = np.concatenate([reward[:25], np.zeros((3, 5), np.float32)])
    sums = RewardSums.none(5).plus(padded, 25).plus(reward[25:], 15)
    for found, part in zip(scores(TEAM, sums, EliteConfig()), TEAM.agent_slices(), strict=True):
        own = reward[:, part].astype(np.float64)
        wanted = own.mean(axis=0) - 0.1 * (own / np.abs(own).mean()).var(axis=0)
        np.testing.assert_allclose(found, wanted, rtol=1e-9)


def test_what_agents_did_long_ago_counts_less() -> None:
    """After many steps of another reward the mean is nearly the new one, and the sums stay bounded."""
    sums = RewardSums.none(1).plus(np.full((MOST_STEPS, 1), 5.0, np.float32), MOST_STEPS)
    for _ in range(10):
        sums = sums.plus(np.ones((MOST_STEPS // 2, 1), np.float32), MOST_STEPS // 2)
        assert sums.steps <= MOST_STEPS
    assert 1.0 <= sums.sums[0, 0] / sums.steps < 1.1


@pytest.mark.parametrize(
    ("steps", "sums"),
    [
        (1.0, np.zeros((3, 4))),
        (1.0, np.zeros((2, 5))),
        (1.0, np.zeros((3, 5), np.float32)),
        (-1.0, np.zeros((3, 5))),
        (float("nan"), np.zeros((3, 5))),
        (1.0, np.full((3, 5), np.inf)),
        (1.0, np.full((3, 5), -1.0)),
    ],
)
def test_sums_that_no_steps_have_are_refused(steps: float, sums: NDArray[np.float64]) -> None:
    """What comes from elsewhere fits the team, and is finite and of the right sign."""
    with pytest.raises(SchemaError):
        RewardSums.checked(steps, sums, 5)


def test_the_plan_follows_from_seed_and_event() -> None:
    """Farms are distinct training farms, equal for equal seed and event, and differ between events."""
    config = preset("eia-sec")
    farms, episodes = evaluation_plan(config, 1)
    assert len(set(farms)) == len(farms) == len(episodes) == config.elite.farms
    assert set(farms) <= set(range(config.rollout.train_farms))
    assert (farms, episodes) == evaluation_plan(config, 1)
    assert (farms, episodes) != evaluation_plan(config, 2)
