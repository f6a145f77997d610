"""The compiled assignment: the least cost, and the very choice of scipy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from common.config import FarmConfig, RelayConfig, WorldConfig
from common.errors import ConfigError
from rollout.kernel.assignment import assign, settle


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


@settings(max_examples=200, deadline=None)
@given(
    relays=st.integers(1, 6),
    rows=st.integers(1, 12),
    room=st.integers(0, 2),
    ties=st.sampled_from([0, 2, 5]),
    seed=st.integers(0, 2**32 - 1),
)
def test_what_settles_is_the_only_best_assignment(relays, rows, room, ties, seed):
    """From any start; with costs that repeat it says so wherever another assignment costs as little."""
    random = np.random.default_rng(seed)
    capacity = -(-rows // relays) + room
    cost = random.integers(0, ties, (rows, relays)).astype(np.float64) if ties else random.normal(size=(rows, relays))
    chosen = random.permutation(np.repeat(np.arange(relays), capacity))[:rows]
    load, exchange, mover = np.zeros(relays, np.int64), np.zeros((relays, relays)), np.zeros((relays, relays), np.int64)
    settled = settle(cost, chosen, capacity, load, exchange, mover)
    assert np.bincount(chosen, minlength=relays).max() <= capacity
    row, column = linear_sum_assignment(np.repeat(cost, capacity, axis=1))
    best, least = column // capacity, cost[row, column // capacity].sum()
    if settled:
        np.testing.assert_array_equal(chosen, best)
    others = [cheapest_other(cost, capacity, r, int(best[r])) for r in range(rows)]
    if min(others) > least + 1e-6:
        assert settled or cost[np.arange(rows), chosen].sum() > least + 1e-9
    if min(others) < least + 1e-12:
        assert not settled


def cheapest_other(cost: np.ndarray, capacity: int, row: int, relay: int) -> float:
    """Return the least cost of the assignments in which one row has another relay than this."""
    without = cost.copy()
    without[row, relay] = 1e6
    rows, columns = linear_sum_assignment(np.repeat(without, capacity, axis=1))
    return float(without[rows, columns // capacity].sum())


def test_a_capacity_that_cannot_serve_everybody_is_refused():
    """Two relays of two cannot serve eight."""
    with pytest.raises(ConfigError):
        FarmConfig(world=WorldConfig(communication_uavs=2), relay=RelayConfig(capacity=2))
