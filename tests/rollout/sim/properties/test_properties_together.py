"""Everything at once: links that count, failures, stress, batteries, wind and zones, on any farm."""

from dataclasses import replace

import numpy as np
from hypothesis import given

from common.config import BatteryConfig, StressConfig
from rollout.envs.spaces import row_box
from rollout.sim.reference.farm import ReferenceFarm
from tests.rollout.sim.properties.strategies import Flight, dose, farm_configs, flights, placed
from tests.rollout.sim.properties.test_properties_airspace import SMALL, airspaces, started
from tests.rollout.sim.properties.test_properties_battery import batteries
from tests.rollout.sim.properties.test_properties_reference import agree_on_directions, assert_equal
from tests.rollout.sim.properties.test_properties_stress import stresses


@dose(30)
@given(flights(airspaces(farm_configs(SMALL))), stresses(), batteries())
def test_any_flight_with_everything_equals_the_reference(flight: Flight, stress: StressConfig, battery: BatteryConfig):
    """Every quantity after every step, within the bounds of the observation."""
    config = flight.config
    config = replace(
        config,
        stress=stress,
        battery=battery,
        relay=replace(config.relay, require_link=True),
        reward=replace(config.reward, relayed=0.5),
        observation=replace(config.observation, stress=True, charge=True, wind=True, zones=True),
    )
    flight = replace(flight, config=config)
    batch, layout, positions = started(flight)
    box = row_box(config)
    with placed(layout, positions):
        reference = ReferenceFarm(config, layout, flight.episode)
    reference._assign(batch.assignment[0])
    reference._look()
    agree_on_directions(batch, reference)
    assert_equal(batch, reference)
    for action in flight.actions()[:20]:
        batch.step(action[None])
        reference.step(action, batch.assignment[0])
        agree_on_directions(batch, reference)
        assert_equal(batch, reference)
        np.testing.assert_array_equal(batch.gone[0], reference.gone)
        np.testing.assert_array_equal(batch.patch_known[0], reference.known)
        np.testing.assert_allclose(batch.charge[0], reference.charge, rtol=1e-9, atol=1e-6)
        assert box.contains(batch.observation[0])
