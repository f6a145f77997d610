"""Flight with inertia: the closed form, the border, energy, where UAVs can stop, and what the options refuse."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eia_sec.common.config import DynamicsConfig, FarmConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm import farm_environment
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.core.dynamics import glide
from eia_sec.rollout.sim.reference.dynamics import course
from eia_sec.rollout.sim.reference.power import flight_power, other_power
from tests.rollout.sim.course import begin
from tests.rollout.sim.properties.strategies import Flight, dose

USUAL = preset("instant").farm
FARM = replace(
    USUAL, dynamics=DynamicsConfig(model="inertial", delay=(0.25,)), observation=replace(USUAL.observation, route=False)
)
TINY = 1e-4
"""Seconds between the decisions of a controller that is followed step by step."""
STATES = st.tuples(st.floats(-12, 12), st.floats(-1, 1), st.floats(-12, 12))
"""Velocity, acceleration over its limit, and the velocity to reach."""
LIMITS = st.tuples(st.floats(0.5, 9.0), st.floats(0.5, 50.0))


def controlled(v: float, a: float, wanted: float, most: float, jerk: float, seconds: float) -> tuple[float, float]:
    """Return the way and the velocity under a controller that decides anew all the time.

    It raises the acceleration while the velocity would end below the wanted one if the acceleration ended now.
    """
    way = 0.0
    for _ in range(round(seconds / TINY)):
        up = v + a * abs(a) / (2.0 * jerk) < wanted
        then = min(most, max(-most, a + (jerk if up else -jerk) * TINY))
        way += TINY * (v + 0.5 * TINY * a)
        v, a = v + 0.5 * TINY * (a + then), then
    return way, v


@dose(25)
@given(STATES, LIMITS, st.sampled_from([0.3, 1.0, 2.5]))
def test_the_closed_form_is_what_a_controller_flies(state, limits, seconds):
    """Way and velocity to within what a controller's short steps leave open."""
    v, share, wanted = state
    most, jerk = limits
    way, velocity, _ = glide(v, share * most, wanted, most, jerk, seconds)
    expected, end = controlled(v, share * most, wanted, most, jerk, seconds)
    assert way == pytest.approx(expected, abs=0.02)
    assert velocity == pytest.approx(end, abs=0.02)


@dose(200)
@given(STATES, LIMITS, st.floats(0.0, 20.0))
def test_the_closed_form_equals_the_reference_and_keeps_its_limits(state, limits, seconds):
    """No acceleration beyond its limit, no velocity beyond where it would end anyway, and at last the wanted one."""
    v, share, wanted = state
    most, jerk = limits
    found = glide(v, share * most, wanted, most, jerk, seconds)
    np.testing.assert_allclose(found, course(v, share * most, wanted, limits, seconds), rtol=1e-9, atol=1e-9)
    level = v + 0.5 * share * most * abs(share * most) / jerk
    assert abs(found[2]) <= most * (1.0 + 1e-9)
    assert min(v, level, wanted) - 1e-9 <= found[1] <= max(v, level, wanted) + 1e-9
    assert glide(v, share * most, wanted, most, jerk, 1e6)[1:] == (wanted, 0.0)


@dose(50)
@given(STATES, LIMITS, st.floats(0.0, 3.0), st.floats(0.0, 3.0))
def test_a_flight_may_be_cut_anywhere(state, limits, first, second):
    """Some time and then some more lead to the same as both at once."""
    v, share, wanted = state
    most, jerk = limits
    way, mid, a = glide(v, share * most, wanted, most, jerk, first)
    on, end, last = glide(mid, max(-most, min(most, a)), wanted, most, jerk, second)
    whole = glide(v, share * most, wanted, most, jerk, first + second)
    np.testing.assert_allclose((way + on, end, last), whole, rtol=1e-6, atol=1e-6)


def sent(config: FarmConfig, command: tuple[float, float], steps: int, place: tuple[float, float] = (200.0, 200.0)):
    """Return a batch whose UAVs all fly from one place to one command for some steps."""
    batch = FarmBatch(config, 1)
    batch.reset(0, 0, 0)
    batch.position[0] = place
    for _ in range(steps):
        batch.step(np.tile(np.array(command, np.float32), config.world.uavs)[None])
    return batch


def test_px4s_limits_by_hand():
    """From rest to 8.4 m/s: 0.25 s nothing, 0.75 s of rising acceleration, and 3.55 s in all until it is reached."""
    batch = sent(FARM, (1.0, 0.0), 1)
    np.testing.assert_allclose(batch.motion[0, 0], [4.0 * 0.75**2 / 2.0, 0.0, 3.0, 0.0, 8.4, 0.0], atol=1e-9)
    np.testing.assert_allclose(batch.position[0, 0], [200.0 + 4.0 * 0.75**3 / 6.0, 200.0], atol=1e-9)
    batch = sent(FARM, (1.0, 0.0), 4)
    np.testing.assert_allclose(batch.motion[0, 0, :2], [8.4, 0.0], atol=1e-9)
    reached = 8.4 / 2.0 * (8.4 / 3.0 + 0.75)
    np.testing.assert_allclose(batch.position[0, 0, 0], 200.0 + reached + 8.4 * (4.0 - 0.25 - 3.55), atol=1e-9)


def test_the_border_stops_a_uav_for_good():
    """It stands at the border, pays for each step in which it is sent on, and then leaves as from rest."""
    batch = sent(FARM, (1.0, 0.0), 6, (390.0, 200.0))
    assert batch.position[0, 0].tolist() == [400.0, 200.0]
    assert batch.motion[0, 0].tolist() == [0.0] * 6
    batch.step(np.tile(np.array([-1.0, 0.0], np.float32), FARM.world.uavs)[None])
    np.testing.assert_allclose(batch.position[0, 0, 0], 400.0 - 4.0 * 0.75**3 / 6.0, atol=1e-9)


def test_energy_is_that_of_the_mean_speed_with_what_accelerating_takes():
    """More thrust than the weight, and the kinetic energy; braking wins nothing back."""
    batch, energy = sent(FARM, (1.0, 0.0), 1), FARM.energy
    v, way = 4.0 * 0.75**2 / 2.0, 4.0 * 0.75**3 / 6.0
    load = math.sqrt(1.0 + (v / energy.gravity) ** 2)
    flight = flight_power(energy, way, load) + 0.5 * energy.mass * v**2
    assert batch.energy[0, 0] == pytest.approx(flight + other_power(energy, 0), rel=1e-9)
    batch = sent(FARM, (1.0, 0.0), 8)
    cruise = batch.energy[0, 0]
    batch.step(np.zeros((1, 24), np.float32))
    assert other_power(energy, 0) < batch.energy[0, 0] < 1.1 * cruise


def test_uavs_stop_where_they_see_that_they_can():
    """Told to stand, each ends up at its own place plus the way that it saw, over the longest such way."""
    flight = Flight(FARM, 3, 5)
    batch, random = begin(flight), np.random.default_rng(0)
    for _ in range(12):
        batch.step(random.uniform(-1.0, 1.0, (1, 24)).astype(np.float32))
    spec, expected = farm_environment(FARM), []
    for group, rows in zip(spec.team.groups, batch.team.split_observations(batch.observation[0]), strict=True):
        seen = dict(zip(spec.tensor_names[group.name].observation, rows.T.astype(np.float64), strict=True))
        longest = 8.4 * (0.25 + 0.75) + 0.5 * 8.4 * (8.4 / 3.0 + 0.75)
        expected += [np.stack([seen[f"stop_{k}"] * seen[f"sign_{k}"] * longest for k in "xy"], axis=1)]
    goal = batch.position[0] + np.concatenate(expected)
    for _ in range(8):
        batch.step(np.zeros((1, 24), np.float32))
    np.testing.assert_allclose(batch.position[0], np.clip(goal, 0.0, 400.0), atol=1e-4)


def test_moves_that_overrun_do():
    """Close to a border at speed, the move on is marked, and whoever makes it runs against the border."""
    batch = sent(FARM, (1.0, 0.0), 5, (355.0, 200.0))
    spec = farm_environment(FARM)
    rows = batch.team.split_observations(batch.observation[0])[2]
    seen = dict(zip(spec.tensor_names["collection"].observation, rows.T, strict=True))
    assert (seen["sign_x"] == 1.0).all()
    assert seen["overruns_move_1_0"].all()
    assert not seen["overruns_move_-1_0"].any()
    batch.step(np.tile(np.array([1.0, 0.0], np.float32), 12)[None])
    for _ in range(6):
        batch.step(np.zeros((1, 24), np.float32))
    assert (batch.position[0, 8:, 0] == 400.0).all()


def test_what_cannot_be_is_refused():
    """Routes and plans on the lattice, delays beyond a step, numbers of no type and UAVs that cannot move."""
    with pytest.raises(ConfigError, match=r"observation\.route"):
        replace(USUAL, dynamics=DynamicsConfig(model="inertial"))
    with pytest.raises(ConfigError, match=r"dynamics\.delay 1\.5 exceeds"):
        replace(FARM, dynamics=DynamicsConfig(model="inertial", delay=(1.5,)))
    with pytest.raises(ConfigError, match=r"dynamics\.jerk must be one number"):
        DynamicsConfig(jerk=(4.0, 4.0))
    with pytest.raises(ConfigError, match=r"dynamics\.acceleration must be above 0"):
        DynamicsConfig(acceleration=(0.0,))
