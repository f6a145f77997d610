"""Batteries, on any farm: the balance of each, UAVs that run empty, and the reference farm."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from eia_sec.common.config import BatteryConfig, FarmConfig
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.stations import station_places
from tests.rollout.sim.course import begin
from tests.rollout.sim.properties.strategies import Flight, dose, farm_configs, flights, worlds
from tests.rollout.sim.properties.test_properties_reference import reference_of
from tests.rollout.sim.tolerances import named_columns

SMALL = worlds(st.integers(1, 5), 90)


@st.composite
def batteries(draw: st.DrawFn) -> BatteryConfig:
    """Draw batteries; many are empty within a few steps, and stations are near."""
    return BatteryConfig(
        capacity=draw(st.sampled_from([30.0, 200.0, 900.0, 1e6])),
        stations=draw(st.integers(1, 7)),
        power=draw(st.sampled_from([1.0, 50.0, 1000.0])),
    )


def charged(config: FarmConfig, battery: BatteryConfig) -> FarmConfig:
    """Return the farm with batteries, which UAVs see."""
    return replace(config, battery=battery, observation=replace(config.observation, charge=True))


@dose(15)
@given(flights(farm_configs(SMALL)), batteries())
def test_kernel_and_reference_agree(flight: Flight, battery: BatteryConfig):
    """Charge, energy, who is gone and what is seen are the reference farm's."""
    flight = replace(flight, config=charged(flight.config, battery))
    batch = begin(flight)
    farm = reference_of(flight, batch)
    columns = named_columns(flight.config, "charge", "station")
    for action in flight.actions()[:16]:
        batch.step(action[None])
        farm.step(action, batch.assignment[0])
        np.testing.assert_array_equal(batch.gone[0], farm.gone)
        np.testing.assert_allclose(batch.charge[0], farm.charge, rtol=1e-9, atol=1e-6)
        np.testing.assert_allclose(batch.energy[0], farm.energy, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(batch.observation[0, columns], farm.observation[columns], rtol=0.0, atol=2e-6)


@dose(10)
@given(flights(farm_configs(SMALL)), batteries())
def test_each_battery_balances(flight: Flight, battery: BatteryConfig):
    """Charge changes by the energy used and by whole steps of charging; an empty battery ends the flight."""
    config = charged(flight.config, battery)
    batch = begin(replace(flight, config=config))
    per_step = battery.power * config.world.step_seconds
    for action in flight.actions():
        before, gone = batch.charge[0].copy(), batch.gone[0].copy()
        batch.step(action[None])
        left, now = ~batch.gone[0], batch.charge[0]
        assert batch.gone[0][gone | (before <= 0.0)].all()
        flown = before - batch.energy[0]
        for u in np.flatnonzero(left):
            charging = min(battery.capacity, flown[u] + per_step)
            assert min(abs(now[u] - flown[u]), abs(now[u] - charging)) < 1e-6
        assert (now[left] <= battery.capacity).all()
        assert (now[~left] == before[~left]).all()


def test_a_uav_that_has_landed_charges_and_goes_on():
    """At a station it needs only its payload's power, and its battery fills."""
    config = FarmConfig(battery=BatteryConfig(capacity=3000.0, stations=1, power=500.0))
    farms = FarmBatch(config, 1)
    farms.reset(0, 3, 1)
    station = station_places(config)[0]
    for _ in range(60):
        way = np.clip((station - farms.position[0]) / 10.0, -1.0, 1.0)
        farms.step(way.reshape(1, -1).astype(np.float32))
    landed = np.linalg.norm(farms.position[0] - station, axis=1) < 1.0
    assert landed.all()
    assert np.array_equal(farms.charge[0], np.full(12, 3000.0))
    assert (farms.energy[0] < 35.0).all()


def test_a_uav_that_never_lands_runs_empty():
    """Full speed empties a battery of 3 kJ; the UAV is gone from the next step on."""
    config = FarmConfig(battery=BatteryConfig(capacity=3000.0))
    farms = FarmBatch(config, 1)
    farms.reset(0, 3, 1)
    rates, step = [], 0
    while not farms.gone.any():
        step += 1
        assert step < 300
        farms.step(np.full((1, 24), 1.0 if step % 2 else -1.0, np.float32))
        rates.append(farms.energy[0])
    assert farms.summary(0).metrics["failed"] >= 1.0


def test_stations_are_even_over_the_field():
    """Four are in the middle of the quarters, three in two columns."""
    quarters = station_places(FarmConfig())
    assert sorted(map(tuple, quarters)) == [(100.0, 100.0), (100.0, 300.0), (300.0, 100.0), (300.0, 300.0)]
    three = station_places(FarmConfig(battery=BatteryConfig(stations=3)))
    assert sorted(map(tuple, three)) == [(100.0, 200.0), (300.0, 100.0), (300.0, 300.0)]
