"""How runs are summed up: the definitions behind every number and verdict of the studies.

Scores are [runs, farms]: one row for each seed of a method, one column for each unseen farm, the same farms for all.

- normalised score: 0 is the random policy on that team and those farms, 1 the best heuristic there.
- interquartile mean: the mean of the middle half of all scores (Agarwal et al. 2021, Deep reinforcement learning at the
  edge of the statistical precipice; the library rliable computes the same).
- interval: 95 % percentiles of a bootstrap over a method's seeds. A seed is drawn with all its farms, since one policy
  flew them, and every farm is in every draw exactly once: the farms are fixed, and an interval says nothing about other
  ones. rliable draws each farm's runs apart, which for one policy on many farms gives far too narrow intervals. Of few
  seeds an interval contains the truth less often than 95 % of the time; `coverage.py` counts how often.
- probability of improvement of X over Y: how often a run of X is above a run of Y on the same farm, a tie counting
  half, mean over the farms.
- convergence: the first episode from which on the smoothed training curve stays within 5 % of its final value.
- stability: the spread of the training curve over the last 10 % of the episodes, and the spread over unseen farms.
"""

import math
from collections.abc import Callable, Sequence
from typing import Final

import numpy as np

from eia_sec.common.errors import ConfigError
from eia_sec.common.seeds import stream
from eia_sec.deploy.reports.intervals import RESAMPLES, Interval, Numbers, between, interquartile_mean
from eia_sec.deploy.reports.plots import smooth

BAND: Final = 0.05
"""Share of the final value within which a curve counts as converged."""
TAIL: Final = 0.1
"""Share of the episodes at the end that final value and spread are taken over."""


def mean(scores: Numbers) -> Numbers:
    """Return the mean of all scores [..., runs, farms], one for each leading index."""
    found: Numbers = scores.mean(axis=(-2, -1))
    return found


def interval(scores: Numbers, statistic: Callable[[Numbers], Numbers] = interquartile_mean) -> Interval:
    """Return a statistic of one method's scores [runs, farms] and its bootstrap interval.

    With a single run there is nothing to draw from, and both ends are the number itself.
    """
    drawn = stream("studies", "bootstrap").integers(len(scores), size=(RESAMPLES, len(scores)))
    return between(float(statistic(scores)), statistic(scores[drawn]))


def improvement(scores: Numbers, other: Numbers) -> float:
    """Return the probability that a run of the first [n, farms] is above one of the second [m, farms]."""
    return float(_wins(scores, other).mean())


def improvement_interval(scores: Numbers, other: Numbers) -> Interval:
    """Return the probability of improvement and its bootstrap interval, the seeds of both methods drawn apart.

    With a single run of either there is nothing to draw from, and it may be anything.
    """
    draw, wins = stream("studies", "improvement"), _wins(scores, other)
    if min(wins.shape[:2]) < 2:
        return Interval(float(wins.mean()), 0.0, 1.0)
    rows, columns = (draw.integers(count, size=(RESAMPLES, count)) for count in wins.shape)
    drawn = wins[rows[:, :, None], columns[:, None, :]].mean(axis=(1, 2))
    return between(float(wins.mean()), drawn)


def difference_interval(values: Numbers, other: Numbers) -> Interval:
    """Return how far the mean of the first seeds' values [n] is above that of the second's [m], seeds drawn apart.

    With a single seed of either there is nothing to draw from, and it may be anything.
    """
    if min(len(values), len(other)) < 2:
        return Interval(float(values.mean() - other.mean()), -math.inf, math.inf)
    draw = stream("studies", "difference")
    one, two = (own[draw.integers(len(own), size=(RESAMPLES, len(own)))].mean(axis=1) for own in (values, other))
    return between(float(values.mean() - other.mean()), one - two)


def normalised(reward: Numbers, random: Numbers, best: Numbers) -> Numbers:
    """Return rewards on the scale on which the random policy is 0 and the best heuristic 1.

    Args:
        reward: [..., farms] reward per agent.
        random: [farms] that of the random policy.
        best: [farms] that of the best heuristic.

    Both ends are interquartile means over the farms, the statistic by which methods are compared.
    So the best heuristic is at 1 in every table, and one odd farm does not stretch its own scale.

    Raises:
        ConfigError: the best heuristic earns no more than the random policy.
    """
    low, high = (float(interquartile_mean(end[None])) for end in (random, best))
    if high <= low:
        raise ConfigError("on this farm the best heuristic earns no more than the random policy; there is no scale.")
    return (reward - low) / (high - low)


def convergence(episodes: Sequence[float], values: Sequence[float]) -> float | None:
    """Return the first episode from which on the smoothed curve stays within BAND of its final value.

    Args:
        episodes: the curve's points, rising.
        values: the curve, unsmoothed.

    Returns:
        The episode, or None when the curve enters the band for good only inside its last TAIL, of which the final value
        is the mean: it has not converged.
    """
    curve = smooth(np.array(values, np.float64))
    tail = tail_of(len(curve))
    final = float(curve[tail:].mean())
    outside = np.flatnonzero(np.abs(curve - final) > BAND * abs(final))
    first = int(outside[-1]) + 1 if outside.size else 0
    return None if first >= tail else float(episodes[first])


def final_value(values: Sequence[float]) -> float:
    """Return the mean over the last TAIL of a curve."""
    return float(np.mean(np.array(values, np.float64)[tail_of(len(values)) :]))


def unrest(values: Sequence[float]) -> float:
    """Return the standard deviation of a training curve over its last TAIL."""
    return float(np.std(np.array(values, np.float64)[tail_of(len(values)) :]))


def spread(reward: Numbers) -> float:
    """Return the standard deviation over unseen farms [runs, farms], of each run by itself, mean over the runs."""
    return float(np.mean(np.std(reward, axis=-1)))


def tail_of(count: int) -> int:
    """Return the first index of the last TAIL of so many points; at least one point is behind it."""
    return min(count - 1, int(np.ceil(count * (1.0 - TAIL))))


def _wins(scores: Numbers, other: Numbers) -> Numbers:
    """Return for each pair of runs [n, m] on which share of the farms the first is above, a tie counting half."""
    one, two = scores[:, None], other[None]
    wins: Numbers = ((one > two) + 0.5 * (one == two)).mean(axis=-1)
    return wins
