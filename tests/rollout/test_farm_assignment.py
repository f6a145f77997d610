"""The compiled assignment: least cost, and never more UAVs on a relay than its capacity."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from common.config import FarmConfig, RelayConfig, WorldConfig
from common.errors import ConfigError
from rollout.farms import FarmBatch
from rollout.kernel.assignment import assign


def solve(cost: np.ndarray) -> np.ndarray:
    rows, columns = cost.shape
    chosen = np.zeros(rows, np.int64)
    assign(cost, np.zeros((3, columns)), np.zeros((4, columns), np.int64), chosen)
    return chosen


@settings(max_examples=300, deadline=None)
@given(
    rows=st.integers(1, 12), extra=st.integers(0, 8), ties=st.sampled_from([0, 1, 2, 5]), seed=st.integers(0, 2**32 - 1)
)
def test_the_cost_is_that_of_scipy(rows, extra, ties, seed):
    """Equal to scipy's on random matrices, square and rectangular, with and without ties; each column once."""
    random = np.random.default_rng(seed)
    shape = (rows, rows + extra)
    cost = random.integers(0, ties, shape).astype(np.float64) if ties else random.normal(size=shape)
    chosen = solve(cost)
    assert len(set(chosen.tolist())) == rows
    row, column = linear_sum_assignment(cost)
    assert cost[np.arange(rows), chosen].sum() == pytest.approx(cost[row, column].sum(), abs=1e-9)
    np.testing.assert_array_equal(chosen, column)


@pytest.mark.parametrize(
    ("c", "m", "d", "capacity"), [(4, 4, 4, 0), (3, 5, 2, 0), (2, 3, 4, 5), (7, 1, 2, 0), (1, 6, 6, 0), (6, 9, 9, 3)]
)
def test_no_relay_serves_more_than_its_capacity(c, m, d, capacity):
    """Over random steps every served UAV has a relay, and no relay is overloaded."""
    config = FarmConfig(
        world=WorldConfig(communication_uavs=c, monitoring_uavs=m, collection_uavs=d),
        relay=RelayConfig(capacity=capacity),
    )
    allowed = capacity or -(-(m + d) // c)
    batch = FarmBatch(config, 2)
    for index in range(2):
        batch.reset(index, index, 0)
    random = np.random.default_rng(0)
    for _ in range(30):
        batch.step(random.uniform(-1.0, 1.0, (2, 2 * (c + m + d))).astype(np.float32))
        for row in batch.assignment:
            assert np.bincount(row, minlength=c).max() <= allowed
            assert ((row >= 0) & (row < c)).all()


def test_a_capacity_that_cannot_serve_everybody_is_refused():
    """Two relays of two cannot serve eight."""
    with pytest.raises(ConfigError):
        FarmConfig(world=WorldConfig(communication_uavs=2), relay=RelayConfig(capacity=2))
