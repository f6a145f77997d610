"""The statistics of the studies against known values and against scipy."""

import numpy as np
import pytest
from scipy.stats import mannwhitneyu, trim_mean

from common.errors import ConfigError
from deploy.studies.statistics import (
    convergence,
    final_value,
    improvement,
    improvement_interval,
    interquartile_mean,
    interval,
    mean,
    normalised,
    spread,
    tail_of,
    unrest,
)


@pytest.mark.parametrize(
    ("scores", "mean"),
    [
        ([[1.0, 2.0, 3.0, 4.0], [5.0, 6.0, 7.0, 8.0]], 4.5),
        ([[0.0, 0.0, 0.0, 1e9]], 0.0),
        ([[-1e9, 2.0, 4.0, 1e9]], 3.0),
        ([[7.0]], 7.0),
    ],
)
def test_interquartile_mean_of_known_scores(scores, mean):
    """The middle half counts, and outliers on either side do not."""
    assert interquartile_mean(np.array(scores)) == pytest.approx(mean)


def test_interquartile_mean_takes_runs_and_farms_together():
    """It is scipy's trimmed mean over all of them, for every one of several sets of scores."""
    scores = np.random.default_rng(0).normal(size=(3, 5, 7))
    wanted = [trim_mean(own, 0.25, axis=None) for own in scores]
    np.testing.assert_allclose(interquartile_mean(scores), wanted)


def test_an_interval_draws_whole_seeds():
    """Two seeds that differ on all farms alike leave the mean open between them, however many farms there are."""
    scores = np.repeat([[0.0], [1.0]], 500, axis=1)
    found = interval(scores, mean)
    assert found == (0.5, 0.0, 1.0)


def test_an_interval_repeats_itself_and_shrinks_with_seeds():
    """Equal scores give equal intervals; twenty seeds give a narrower one than four that contains the true mean."""
    scores = np.random.default_rng(1).normal(3.0, 1.0, (20, 1)) + np.zeros((1, 10))
    few, many = interval(scores[:4]), interval(scores)
    assert interval(scores) == many
    assert many.high - many.low < few.high - few.low
    assert many.low < 3.0 < many.high
    assert many.low <= many.value <= many.high


def test_one_seed_has_no_interval():
    """With nothing to draw from, both ends are the number itself."""
    found = interval(np.array([[1.0, 2.0, 3.0, 4.0]]))
    assert found.low == found.high == found.value == 2.5


def test_intervals_cover_the_truth_about_as_often_as_they_say():
    """Of 60 experiments with ten seeds, the interval of the mean misses the true one in few, and not in none."""
    generator = np.random.default_rng(2)
    found = [interval(generator.normal(0.0, 1.0, (10, 1)), mean) for _ in range(60)]
    missed = sum(not low <= 0.0 <= high for _, low, high in found)
    assert 1 <= missed <= 12


def test_improvement_is_the_mann_whitney_statistic_of_each_farm():
    """On every farm it is U / (n m), which scipy computes too, ties counting half."""
    generator = np.random.default_rng(3)
    one, other = generator.integers(0, 5, (6, 9)).astype(float), generator.integers(1, 6, (4, 9)).astype(float)
    wanted = [mannwhitneyu(one[:, farm], other[:, farm]).statistic / 24 for farm in range(9)]
    assert improvement(one, other) == pytest.approx(np.mean(wanted))
    assert improvement(other, one) == pytest.approx(1.0 - np.mean(wanted))


def test_improvement_of_known_scores():
    """Always above gives 1, always below 0, equal one half."""
    low, high = np.zeros((3, 2)), np.ones((2, 2))
    assert improvement(high, low) == 1.0
    assert improvement(low, high) == 0.0
    assert improvement(low, low) == 0.5
    assert improvement_interval(high, low) == (1.0, 1.0, 1.0)
    assert improvement_interval(high[:1], low[:1]) == (1.0, 1.0, 1.0)


def test_improvement_interval_is_open_where_seeds_disagree():
    """One seed above and one below leaves everything between 0 and 1 possible."""
    found = improvement_interval(np.array([[0.0], [2.0]]), np.array([[1.0]]))
    assert found == (0.5, 0.0, 1.0)


def test_the_normalised_scale_has_its_ends():
    """Random is 0, the best heuristic 1, by their means over the farms."""
    random, best = np.array([-100.0, -300.0]), np.array([700.0, 900.0])
    assert normalised(random, random, best).mean() == pytest.approx(0.0)
    assert normalised(best, random, best).mean() == pytest.approx(1.0)
    np.testing.assert_allclose(normalised(np.array([[300.0, 800.0]]), random, best), [[0.5, 1.0]])
    with pytest.raises(ConfigError, match="no more than the random policy"):
        normalised(best, best, random)


def test_convergence_of_a_step():
    """With 200 points the window has 11, so the smoothed step is within 5 % once all of them are behind it."""
    episodes = [10.0 * point for point in range(1, 201)]
    values = [0.0] * 100 + [100.0] * 100
    assert convergence(episodes, values) == episodes[105]


def test_convergence_of_a_flat_and_of_a_restless_curve():
    """A flat curve has converged from the start; one that still leaves the band at its end has not."""
    episodes = list(range(1, 201))
    assert convergence(episodes, [5.0] * 200) == 1
    assert convergence(episodes, [5.0] * 190 + [50.0] * 10) is None
    assert convergence(episodes, [100.0 * point for point in range(200)]) is None


def test_a_relapse_counts():
    """Convergence is the last entry into the band, not the first."""
    values = [100.0] * 60 + [20.0] * 40 + [100.0] * 100
    assert convergence(list(range(200)), values) == 105


def test_final_value_and_unrest_are_of_the_last_tenth():
    """Only the last 10 % count, and at least one point does."""
    values = [1000.0] * 90 + [1.0, 3.0] * 5
    assert final_value(values) == pytest.approx(2.0)
    assert unrest(values) == pytest.approx(1.0)
    assert tail_of(100) == 90
    assert tail_of(1) == 0
    assert final_value([4.0]) == 4.0


def test_spread_is_over_farms_inside_each_run():
    """Runs that differ from one another but not over farms have no spread."""
    assert spread(np.array([[1.0, 1.0], [9.0, 9.0]])) == 0.0
    assert spread(np.array([[0.0, 2.0], [0.0, 4.0]])) == pytest.approx(1.5)
