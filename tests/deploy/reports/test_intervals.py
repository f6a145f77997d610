"""Interquartile means and their intervals against known values, scipy and a plain bootstrap."""

import numpy as np
import pytest
from scipy.stats import trim_mean

from eia_sec.deploy.reports.intervals import interquartile_mean, stratified_interval


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


def test_interquartile_mean_takes_runs_and_tasks_together():
    """It is scipy's trimmed mean over all of them, for every one of several sets of scores."""
    scores = np.random.default_rng(0).normal(size=(3, 5, 7))
    wanted = [trim_mean(own, 0.25, axis=None) for own in scores]
    np.testing.assert_allclose(interquartile_mean(scores), wanted)


def test_an_interval_is_that_of_a_plain_stratified_bootstrap():
    """Runs are drawn with replacement within each task, and the middle 95 % of the draws is the interval."""
    scores = np.random.default_rng(1).normal([0.0, 5.0, -5.0], size=(6, 3))
    draw = np.random.default_rng(2)
    drawn = []
    for _ in range(4000):
        columns = [column[draw.integers(6, size=6)] for column in scores.T]
        drawn.append(trim_mean(np.stack(columns), 0.25, axis=None))
    found = stratified_interval(scores)
    assert found.value == pytest.approx(trim_mean(scores, 0.25, axis=None))
    assert found[1:] == pytest.approx(np.quantile(drawn, [0.025, 0.975]), abs=0.08)
    assert stratified_interval(scores) == found


def test_each_task_draws_its_own_runs():
    """Seeds that differ alike on many tasks are not drawn as wholes, so their differences cancel."""
    scores = np.repeat([[0.0], [1.0]], 500, axis=1)
    found = stratified_interval(scores)
    assert found.value == 0.5
    assert 0.3 < found.low < found.high < 0.7
    alone = stratified_interval(scores[:, :1])
    assert alone == (0.5, 0.0, 1.0)


def test_one_run_has_no_width():
    """There is nothing to draw from."""
    assert stratified_interval(np.array([[3.0]])) == (3.0, 3.0, 3.0)
