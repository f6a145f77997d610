"""The statistics of the studies against known values and against scipy."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from eia_sec.common.errors import ConfigError
from eia_sec.deploy.reports.intervals import LEVEL, interquartile_mean
from research.pages.reproduce_tables import COVERAGE as COVERAGE_FILE
from research.studies.analysis.coverage import block, coverage
from research.studies.analysis.statistics import (
    convergence,
    difference_interval,
    final_value,
    improvement,
    improvement_interval,
    interval,
    mean,
    normalised,
    spread,
    tail_of,
    unrest,
)
from research.studies.analysis.verdicts import above, far, judged

COVERAGE = Path(__file__).resolve().parents[3] / COVERAGE_FILE
EXPERIMENTS = 300


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


@pytest.mark.parametrize("seeds", [3, 5])
def test_intervals_hold_the_truth_as_often_as_the_page_says(seeds):
    """Counted anew with the studies' own functions, each share is within four standard errors of the committed one."""
    said = json.loads(COVERAGE.read_text(encoding="utf-8"))["seeds"][str(seeds)]
    found = coverage(seeds, EXPERIMENTS, np.random.default_rng(seeds))
    for name, share in said.items():
        error = np.sqrt(share * (1.0 - share) / EXPERIMENTS)
        assert found[name] == pytest.approx(share, abs=4.0 * error), name


def test_few_seeds_promise_less_than_their_name():
    """What the page says of the committed shares is what they are: below 95 %, and nearer to it with more seeds."""
    said = json.loads(COVERAGE.read_text(encoding="utf-8"))["seeds"]
    held = [said[seeds]["interval"] for seeds in ("3", "5", "10")]
    assert held == sorted(held)
    assert held[-1] < LEVEL
    apart = [said[seeds]["told_apart"] for seeds in ("3", "5", "10")]
    assert apart == sorted(apart, reverse=True)
    text = block({"command": "c", "commit": "abc", "experiments": 2000, "seeds": said})
    assert f"| 3 | {held[0]:.0%} | {apart[0]:.0%} |" in text


def test_an_interval_says_nothing_about_other_farms():
    """Farms are not drawn: seeds that agree on every farm have an interval of no width, however farms differ."""
    scores = np.repeat([[1.0, 50.0, 900.0, -7.0]], 3, axis=0)
    assert interval(scores).low == interval(scores).high


def test_a_difference_draws_both_methods_seeds():
    """Its number is that of the means, and its ends are the largest differences that single seeds can make."""
    found = difference_interval(np.array([1.0, 3.0]), np.array([0.0, 0.5]))
    assert found == (1.75, 0.5, 3.0)


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


def test_improvement_interval_is_open_where_seeds_disagree():
    """One seed above and one below leaves everything between 0 and 1 possible."""
    found = improvement_interval(np.array([[0.0], [2.0]]), np.array([[1.0]]))
    assert found == (0.5, 0.0, 1.0)


def test_the_normalised_scale_has_its_ends():
    """Random is 0, the best heuristic 1, by their interquartile means over the farms."""
    random, best = np.array([-100.0, -300.0]), np.array([700.0, 900.0])
    odd = np.array([-9e9, 700.0, 900.0, 9e9])
    assert interquartile_mean(normalised(odd, np.zeros(4), odd)[None]) == pytest.approx(1.0)
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


def test_one_seed_decides_nothing():
    """Of a single run of either method there is nothing to draw from, however clear the farms are."""
    one, two = np.full((1, 80), 2.0), np.stack([np.full(80, 1.0), np.full(80, 1.5)])
    for pair in ((one, two), (two, one), (one, one)):
        assert improvement_interval(*pair)[1:] == (0.0, 1.0)
        assert above(improvement_interval(*pair)) is None
        assert difference_interval(pair[0][:, 0], pair[1][:, 0])[1:] == (-np.inf, np.inf)
        assert far(difference_interval(pair[0][:, 0], pair[1][:, 0])) is None
    assert judged([]) == "undecided"
