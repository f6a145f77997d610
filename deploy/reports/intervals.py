"""Interquartile means and their intervals, as rliable defines them.

Scores are [runs, tasks]: one row for each seed, one column for each task. The interquartile mean is that of the middle
half of all of them (Agarwal et al. 2021, Deep reinforcement learning at the edge of the statistical precipice). The
interval is the middle 95 % of a stratified bootstrap, which draws the runs of each task apart, with replacement. Of few
runs it contains the truth less often than 95 % of the time.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.seeds import stream

Numbers = NDArray[np.float64]

LEVEL: Final = 0.95
"""Share of the bootstrap that an interval holds."""
RESAMPLES: Final = 2000


class Interval(NamedTuple):
    """A number and the ends of its interval."""

    value: float
    low: float
    high: float


def interquartile_mean(scores: Numbers) -> Numbers:
    """Return the mean of the middle half of all scores [..., runs, tasks], one for each leading index."""
    flat = np.sort(scores.reshape(*scores.shape[:-2], -1), axis=-1)
    cut = int(0.25 * flat.shape[-1])
    middle: Numbers = flat[..., cut : flat.shape[-1] - cut].mean(axis=-1)
    return middle


def stratified_interval(scores: Numbers) -> Interval:
    """Return the interquartile mean of scores [runs, tasks] and its stratified bootstrap interval.

    With a single run there is nothing to draw from, and both ends are the number itself.
    """
    runs, tasks = scores.shape
    drawn = stream("benchmark", "bootstrap").integers(runs, size=(RESAMPLES, runs, tasks))
    return between(float(interquartile_mean(scores)), interquartile_mean(scores[drawn, np.arange(tasks)]))


def between(value: float, drawn: Numbers) -> Interval:
    """Return a number with the middle LEVEL of what a bootstrap has drawn [B] as its interval."""
    low, high = np.quantile(drawn, [(1.0 - LEVEL) / 2, (1.0 + LEVEL) / 2])
    return Interval(value, float(low), float(high))
