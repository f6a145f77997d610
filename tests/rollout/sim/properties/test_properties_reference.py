"""The compiled farm against the reference farm, on any farm and any flight, with every switch drawn."""

from collections.abc import Iterator

import numpy as np
from hypothesis import example, given
from hypothesis import strategies as st

from eia_sec.common.config import FarmConfig, WorldConfig
from eia_sec.rollout.envs.spaces import row_box
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.reference.farm import ReferenceFarm
from tests.rollout.sim.course import begin
from tests.rollout.sim.properties.strategies import Flight, dose, farm_configs, flights, placed, worlds
from tests.rollout.sim.tolerances import ROUGH, observation_tolerance

FINE = ("position", "aoi", "vdf", "service", "direction", "energy", "utility", "parts")

CLOSE = 1e-9
"""Sums of fractions closer than this may rank either way."""
TOGETHER = Flight(
    FarmConfig(
        world=WorldConfig(
            communication_uavs=2,
            monitoring_uavs=4,
            collection_uavs=4,
            field_x=64.0,
            field_y=64.0,
            plots_x=4,
            plots_y=4,
            sensors=16,
            sensor_spacing=2.0,
            sensor_cycles=(2.0,),
            vdf_cycle=2.0,
            steps=12,
        )
    ),
    farm=1,
    episode=2,
    starts="together",
    manner="hovering",
)
"""UAVs that stay where others of their type are, so that several are equally near to what they serve."""
SMALL = worlds(st.one_of(st.integers(1, 4), st.integers(1, 10)), 90)


def assert_equal(batch: FarmBatch, reference: ReferenceFarm) -> None:
    tolerances = [(name, 1e-9, 1e-9) for name in FINE]
    tolerances += [("reward", ROUGH, ROUGH), ("observation", ROUGH, observation_tolerance(batch.config))]
    for name, relative, absolute in tolerances:
        ours, theirs = getattr(batch, name)[0], getattr(reference, name)
        off = np.abs(ours - theirs) > absolute + relative * np.abs(theirs)
        message = f"{name} at step {reference.time}, {np.flatnonzero(off)}: {ours[off]} and not {theirs[off]}"
        assert ours.shape == theirs.shape, name
        assert not off.any(), message


def assert_least_cost(batch: FarmBatch, reference: ReferenceFarm) -> None:
    chosen = batch.assignment[0]
    cost = reference.assignment_costs()[np.arange(len(chosen)), chosen].sum()
    np.testing.assert_allclose(cost, reference.assignment_cost, rtol=1e-9, atol=1e-9)


def reference_of(
    flight: Flight, batch: FarmBatch, positions: np.ndarray | None = None, kind: type[ReferenceFarm] = ReferenceFarm
) -> ReferenceFarm:
    """Return the reference farm at the start of a flight, with the assignment of a batch that has begun it."""
    layout = flight.layout()
    with placed(layout, flight.positions() if positions is None else positions):
        reference = kind(flight.config, layout, flight.episode)
    reference._assign(batch.assignment[0])
    reference._look()
    return reference


def flown_beside(flight: Flight, batch: FarmBatch, reference: ReferenceFarm, steps: int = 20) -> Iterator[None]:
    """Fly on both farms; check at the start and after every step that all is equal and the observation in bounds."""
    box = row_box(flight.config)
    assert_equal(batch, reference)
    for action in flight.actions()[:steps]:
        batch.step(action[None])
        reference.step(action, batch.assignment[0])
        assert_equal(batch, reference)
        assert box.contains(batch.observation[0])
        yield


@dose(20)
@given(flights(farm_configs(SMALL)))
@example(TOGETHER)
def test_any_flight_equals_the_reference(flight: Flight):
    """Every quantity after every step; where several assignments cost the same, the reference flies on with ours."""
    batch = begin(flight)
    reference = reference_of(flight, batch)
    np.testing.assert_array_equal(batch.position[0], reference.position)
    assert_least_cost(batch, reference)
    for _ in flown_beside(flight, batch, reference):
        assert_least_cost(batch, reference)
