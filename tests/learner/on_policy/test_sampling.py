"""Sampled actions come as often as the log-probabilities of `eia_sec.common.actions.sampling` state."""

import numpy as np
import pytest
from scipy import stats

from eia_sec.common.actions.sampling import LARGEST_ACTION, sample_options, sample_squashed
from eia_sec.common.team import GroupSpec

MASKED = GroupSpec("masked", 1, 8, 2, choices=(3, 4), masked=True)


def shares(logits, legal):
    """Return the softmax over legal options in double precision."""
    weight = np.exp(logits.astype(np.float64) - logits[legal].max()) * legal
    return weight / weight.sum()


def masked(*legal):
    """Return an observation of MASKED with this mask."""
    return np.array([0.5, *legal], np.float32)


@pytest.mark.parametrize("legal", [[1] * 7, [1, 0, 1, 0, 1, 1, 0]], ids=["free", "masked"])
def test_options_come_as_often_as_they_are_likely(legal):
    """Among 20 000 samples the counts of all pairs of options fit the product of their probabilities (chi-square)."""
    count, draw = 20_000, np.random.default_rng(7)
    logits = draw.normal(0, 1, 7).astype(np.float32)
    uniform = draw.random((count, 2), np.float32)
    indices, stated = sample_options(MASKED, masked(*legal), np.tile(logits, (count, 1)), uniform)
    mask = np.array(legal, bool)
    pairs = np.outer(shares(logits[:3], mask[:3]), shares(logits[3:], mask[3:])).reshape(-1)
    place = (indices[:, 0] * 4 + indices[:, 1]).astype(int)
    counts = np.bincount(place, minlength=12)
    assert not counts[pairs == 0].any()
    assert stats.chisquare(counts[pairs > 0], count * pairs[pairs > 0]).pvalue > 0.001
    np.testing.assert_allclose(stated, np.log(pairs[place]), atol=1e-5)


def test_continuous_actions_are_distributed_as_stated():
    """The artanh of 20 000 samples is normal with the actor's mean and deviation (Kolmogorov-Smirnov)."""
    draw = np.random.default_rng(8)
    mean, log_std = np.float32([0.3, -0.5]), np.float32([-1.0, 0.2])
    action, stated = sample_squashed(
        np.tile(mean, (20_000, 1)), np.tile(log_std, (20_000, 1)), draw.standard_normal((20_000, 2), np.float32)
    )
    normals = [stats.norm(mean[i], np.exp(log_std[i])) for i in range(2)]
    x = np.arctanh(action.astype(np.float64))
    assert all(stats.kstest(x[:, i], normals[i].cdf).pvalue > 0.001 for i in range(2))
    inside = (np.abs(action) < 0.999).all(axis=1)
    wanted = sum(normals[i].logpdf(x[:, i]) for i in range(2))
    np.testing.assert_allclose(stated[inside], wanted[inside], atol=1e-3)


@pytest.mark.parametrize("mean", [-50.0, 50.0])
def test_saturated_actions_have_finite_probabilities(mean):
    """Far beyond the reach of tanh an action is cut at LARGEST_ACTION, and its log-probability is a number."""
    action, stated = sample_squashed(np.float32([mean]), np.float32([0.0]), np.float32([0.0]))
    assert abs(float(action[0])) == np.float32(LARGEST_ACTION)
    assert np.isfinite(stated)
    assert stated < -100.0
