"""Rows are dealt out so that every minibatch has equal shares of them."""

import numpy as np
import pytest

from eia_sec.learner.group.shares import Shares, sizes_of

CASES = [(200, 23, 1, 2, 1), (200, 7, 3, 2, 2), (1000, 50, 16, 3, 4), (999, 31, 7, 8, 5), (40, 3, 4, 2, 2)]
"""Rows, rows from which no step follows, minibatches, learners, block."""


def dealt(rows, gaps, minibatches, learners, block):
    """Return an iteration's samples, and how they are dealt out."""
    ends = np.random.default_rng(rows).choice(rows, gaps, replace=False)
    samples = np.setdiff1d(np.arange(rows), ends)
    return samples, Shares.of(samples, rows, minibatches, learners, block)


@pytest.mark.parametrize("case", CASES)
def test_every_row_has_one_owner(case):
    """The learners' rows follow one another without a gap, and hold all samples."""
    samples, shares = dealt(*case)
    assert (shares.starts[0], shares.starts[-1]) == (0, case[0])
    assert list(shares.starts) == sorted(shares.starts)
    parts = shares.split(samples)
    whole = np.concatenate([part + start for part, start in zip(parts, shares.starts[:-1], strict=True)])
    np.testing.assert_array_equal(whole, samples)


@pytest.mark.parametrize("case", CASES)
def test_every_minibatch_has_equal_shares(case):
    """An epoch has every sample once; learners' parts of a minibatch differ by one block, besides what is left."""
    samples, shares = dealt(*case)
    _, _, count, learners, block = case
    found = shares.minibatches(np.random.default_rng(1).permutation(samples), count)
    np.testing.assert_array_equal(np.sort(np.concatenate(found)), samples)
    assert [len(part) for part in found] == [len(part) for part in np.array_split(samples, count)]
    for part in found:
        sizes = [len(own) for own in shares.split(part)]
        assert sizes == sizes_of(len(part), learners, block)
        assert all(size % block == 0 for size in sizes[:-1])
        assert max(sizes) - min(sizes) < 2 * block
        # The leader sends each learner its own part, and the order inside a minibatch is that of the learners.
        own = [places + start for places, start in zip(shares.split(part), shares.starts[:-1], strict=True)]
        np.testing.assert_array_equal(np.concatenate(own), part)


def test_epochs_differ():
    """Samples keep their owners, and meet others in every epoch."""
    samples, shares = dealt(*CASES[2])
    random = np.random.default_rng(2)
    first, second = (shares.minibatches(random.permutation(samples), 16) for _ in range(2))
    assert not np.array_equal(first[0], second[0])
    assert np.isin(first[0], second[0]).mean() < 0.5
