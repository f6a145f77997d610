"""The compiled assignment: the least cost, and the same choice as scipy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from eia_sec.common.config import FarmConfig, RelayConfig, WorldConfig
from eia_sec.common.errors import ConfigError
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.core.assignment import Exchanges, assign, settle
from eia_sec.rollout.sim.core.compile import compiled
from eia_sec.rollout.sim.core.logarithm import vectorisable_log
from eia_sec.rollout.sim.core.records import make_record
from eia_sec.rollout.sim.layout import make_layout
from eia_sec.rollout.sim.reference.farm import ReferenceFarm


def solve(cost: np.ndarray) -> np.ndarray:
    rows, columns = cost.shape
    chosen = np.zeros(rows, np.int64)
    assign(cost, rows, columns, np.zeros((3, columns)), np.zeros((4, columns), np.int64), chosen)
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


@settings(max_examples=300, deadline=None)
@given(
    relays=st.integers(1, 9),
    rows=st.integers(1, 20),
    room=st.integers(0, 2),
    ties=st.sampled_from([0, 2, 5]),
    seed=st.integers(0, 2**32 - 1),
)
def test_what_settles_is_the_only_best_assignment(relays, rows, room, ties, seed):
    """From any start; with repeated costs it reports wherever another assignment costs as little."""
    random = np.random.default_rng(seed)
    capacity = -(-rows // relays) + room
    cost = random.integers(0, ties, (rows, relays)).astype(np.float64) if ties else random.normal(size=(rows, relays))
    chosen = random.permutation(np.repeat(np.arange(relays), capacity))[:rows]
    settled = settle(cost, chosen, capacity, make_record(Exchanges, {"served": rows, "n_c": relays}))
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


@pytest.mark.parametrize("relay", [RelayConfig(), RelayConfig(capacity=4)], ids=["full relays", "relays with room"])
def test_a_flight_is_assigned_as_by_scipy(relay):
    """At the least cost, on a flight on which UAVs change relays and meet in corners, where several cost as little."""
    config = FarmConfig(world=WorldConfig(communication_uavs=12, monitoring_uavs=12, collection_uavs=12), relay=relay)
    batch, reference = FarmBatch(config, 1), ReferenceFarm(config, make_layout(config, 2), 5)
    batch.reset(0, 2, 5)
    random, action, changed = np.random.default_rng(1), np.zeros((1, batch.team.environment_action_size), np.float32), 0
    equal = 0
    for _ in range(150):
        kept, before = random.uniform(size=action.shape) < 0.95, batch.assignment[0].copy()
        action = np.where(kept, action, random.uniform(-1, 1, action.shape)).astype(np.float32)
        batch.step(action)
        reference.position = batch.position[0]
        reference._assign()
        costs = reference.assignment_costs()[np.arange(24), batch.assignment[0]]
        assert costs.sum() == pytest.approx(reference.assignment_cost, abs=1e-12)
        equal += int((batch.assignment[0] == reference.assignment).all())
        changed += int((batch.assignment[0] != before).sum())
    assert changed > 150
    assert equal >= 130


def test_the_logarithm_is_the_library_s():
    """To 1e-13 of 1 + ln x, from 1 to the square of the longest distance that anybody could ask for."""
    random = np.random.default_rng(0)
    near = 1.0 + 10.0 ** random.uniform(-16.0, 0.0, 2000)
    given = np.concatenate(
        [np.exp(random.uniform(0.0, 40.0, 20_000)), near, 2.0 ** np.arange(60), 2.0 ** np.arange(0.5, 60)]
    )

    @compiled
    def logarithms(numbers, found):
        for k in range(len(numbers)):
            found[k] = vectorisable_log(numbers[k])

    found = np.empty_like(given)
    logarithms(given, found)
    assert (np.abs(found - np.log(given)) <= 1e-13 * (1.0 + np.log(given))).all()


def test_a_capacity_that_cannot_serve_everybody_is_refused():
    """Two relays of two cannot serve eight."""
    with pytest.raises(ConfigError):
        FarmConfig(world=WorldConfig(communication_uavs=2), relay=RelayConfig(capacity=2))
