"""omega rewards a high and steady reward, and the elite is its type's best."""

import numpy as np
import pytest

from eia_sec.common.config import EliteConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import SchemaError
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.elite.evaluation_plan import evaluation_plan
from eia_sec.elite.scoring import decide, scores

TEAM = TeamSpec((GroupSpec("a", 3, 4, 2), GroupSpec("b", 2, 5, 1)))


def test_scores_by_hand() -> None:
    """Omega = beta_1 mu + beta_2 sigma^2 of the rewards over their mean absolute value."""
    reward = np.array([[[1.0, 4.0], [3.0, 0.0]]], np.float32)
    wanted = [2.0 - 0.1 * 0.25, 2.0 - 0.1 * 1.0]
    np.testing.assert_allclose(scores(reward, EliteConfig()), wanted)


def test_the_steadier_of_two_equals_wins() -> None:
    """At equal means the lower variance has the higher omega."""
    reward = np.array([[[2.0, 0.0], [2.0, 4.0]]], np.float32)
    steady, wild = scores(reward, EliteConfig())
    assert steady > wild


def test_scale_does_not_matter_to_the_variance() -> None:
    """A type with rewards a hundred times as large has the same spread in omega relative to its scale."""
    reward = np.random.default_rng(0).normal(1.0, 1.0, (2, 50, 3)).astype(np.float32)
    spread = [scores(each, EliteConfig()) - each.mean(axis=(0, 1)) for each in (reward, reward * np.float32(64))]
    np.testing.assert_allclose(*spread, rtol=1e-3)


def test_zero_rewards_have_zero_scores() -> None:
    """No reward at all divides by nothing."""
    np.testing.assert_array_equal(scores(np.zeros((1, 5, 2), np.float32), EliteConfig()), [0.0, 0.0])


def test_decide_picks_each_types_best() -> None:
    """The elite's index is counted inside its type, and the evaluation's steps are counted."""
    reward = np.zeros((2, 10, 5), np.float32)
    reward[:, :, 2] = 1.0
    reward[:, :, 3] = 1.0
    event = decide(TEAM, EliteConfig(), 2, 7, 20, reward)
    assert (event.elites, event.rate, event.version, event.evaluation_steps) == ((2, 0), 0.05, 7, 20)
    event.check(TEAM)


@pytest.mark.parametrize("shape", [(2, 10, 4), (0, 10, 5), (10, 5)])
def test_evaluations_that_do_not_fit_are_refused(shape: tuple[int, ...]) -> None:
    """Rewards of another team are a SchemaError."""
    with pytest.raises(SchemaError):
        decide(TEAM, EliteConfig(), 1, 1, 10, np.zeros(shape, np.float32))


def test_the_plan_follows_from_seed_and_event() -> None:
    """Farms are distinct training farms, equal for equal seed and event, and differ between events."""
    config = preset("eia-sec")
    farms, episodes = evaluation_plan(config, 1)
    assert len(set(farms)) == len(farms) == len(episodes) == config.elite.farms
    assert set(farms) <= set(range(config.rollout.train_farms))
    assert (farms, episodes) == evaluation_plan(config, 1)
    assert (farms, episodes) != evaluation_plan(config, 2)
