"""Patches and areas of stress, on any farm: what rises when, who knows, and the reference farm."""

from dataclasses import replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from eia_sec.common.config import FarmConfig, StressConfig
from eia_sec.common.config.farm.polygons import Polygon
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.conditions.stress import patches
from tests.constants import with_constants
from tests.rollout.sim.course import begin
from tests.rollout.sim.properties.strategies import Flight, dose, farm_configs, flights, worlds
from tests.rollout.sim.properties.test_properties_added import with_plans_that_fit, with_seen
from tests.rollout.sim.properties.test_properties_reference import reference_of
from tests.rollout.sim.tolerances import named_columns

SMALL = worlds(st.integers(1, 5), 90)


@st.composite
def outlines(draw: st.DrawFn) -> Polygon:
    """Draw a rectangle or a triangle that often covers a part of a field."""
    x, y = (draw(st.integers(-3, 30)) * 9.7 for _ in range(2))
    width, depth = (draw(st.sampled_from([6.1, 23.0, 91.3, 1000.0])) for _ in range(2))
    corners = ((x, y), (x + width, y), (x + width, y + depth), (x, y + depth))
    return corners if draw(st.booleans()) else corners[:3]


@st.composite
def stresses(draw: st.DrawFn) -> StressConfig:
    """Draw patches, areas or both; many patches begin, end and overlap within a short episode."""
    areas = tuple(draw(st.lists(st.tuples(st.integers(1, 9), outlines()), max_size=3)))
    return with_constants(
        StressConfig(areas=areas, patches=draw(st.integers(0 if areas else 1, 12))),
        radius=draw(st.sampled_from([3.0, 17.3, 61.7, 1000.0])),
        growth=draw(st.integers(1, 9)),
        seconds=draw(st.sampled_from([0.1, 2.0, 7.0, 500.0])),
    )


def stressed(config: FarmConfig, stress: StressConfig) -> FarmConfig:
    """Return the farm with patches and areas, which UAVs see."""
    return replace(config, stress=stress, observation=replace(config.observation, stress=True))


@dose(15)
@given(flights(farm_configs(SMALL)), stresses())
def test_kernel_and_reference_agree(flight: Flight, stress: StressConfig):
    """Counters, rewards and observations are the reference farm's."""
    config = stressed(flight.config, stress)
    planning = with_seen(config, {"route": False, "plan": 3})
    flight = replace(flight, config=with_plans_that_fit(planning))
    batch = begin(flight)
    farm = reference_of(flight, batch)
    for action in flight.actions()[:16]:
        batch.step(action[None])
        farm.step(action, batch.assignment[0])
        np.testing.assert_allclose(batch.aoi[0], farm.aoi, rtol=1e-9, atol=1e-9)
        np.testing.assert_array_equal(batch.vdf[0], farm.vdf)
        np.testing.assert_array_equal(batch.patch_known[0], farm.known)
        np.testing.assert_allclose(batch.reward[0], farm.reward, rtol=1e-5, atol=1e-5)
        columns = named_columns(flight.config, "block_stress", "plan")
        np.testing.assert_allclose(batch.observation[0, columns], farm.observation[columns], rtol=0.0, atol=1e-6)


@dose(10)
@given(flights(farm_configs(SMALL)), stresses())
def test_stress_of_no_growth_changes_nothing(flight: Flight, stress: StressConfig):
    """With growth 1, the episode is bit-equal to one without patches and areas."""
    areas = tuple((1, corners) for _, corners in stress.areas)
    with_stress = replace(flight.config, stress=with_constants(replace(stress, areas=areas), growth=1))
    one, two = begin(replace(flight, config=with_stress)), begin(flight)
    for action in flight.actions():
        one.step(action[None])
        two.step(action[None])
        for name in ("aoi", "vdf", "observation", "reward"):
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_counters_rise_faster_in_a_patch_and_as_before_after_it():
    """A plot that nobody visits rises at the multiples of its cycle, which is shorter while a patch covers it."""
    config = FarmConfig(stress=with_constants(StressConfig(patches=1), radius=1000.0, seconds=100.0))
    config = replace(config, camera=with_constants(config.camera, image_distance=1.0))
    farms = FarmBatch(config, 1)
    farms.reset(0, 3, 1)
    first, end = patches(config, 3, 1).time[0]
    before, rises = farms.vdf.copy(), []
    for step in range(1, 501):
        farms.step(np.zeros((1, 24), np.float32))
        if (farms.vdf > before).all():
            rises.append(step)
        assert ((farms.vdf > before).all(), (farms.vdf > before).any()) != (False, True)
        before = farms.vdf.copy()
        if farms.vdf.max() == 5.0:
            break
    wanted = [t for t in range(1, 501) if t % (10 if first <= t < end else 30) == 0]
    assert rises == wanted[:5]


def test_a_patch_is_known_from_the_step_in_which_a_uav_with_a_task_is_over_it():
    """Nobody knows a patch that no monitor and no collector has been over, and it then fades with its end."""
    config = stressed(FarmConfig(), with_constants(StressConfig(patches=3), radius=40.0, seconds=60.0))
    farms = FarmBatch(config, 1)
    farms.reset(0, 5, 2)
    place, time = patches(config, 5, 2)
    random, known = np.random.default_rng(0), np.zeros(3, bool)
    relays = config.world.communication_uavs
    for step in range(1, 501):
        farms.step(random.uniform(-1.0, 1.0, (1, 24)).astype(np.float32))
        apart = np.linalg.norm(farms.position[0, relays:, None] - place, axis=2)
        alive = (time[:, 0] <= step) & (step < time[:, 1])
        known |= alive & (apart <= 40.0).any(axis=0)
        assert np.array_equal(farms.patch_known[0], known)
        assert farms.stressed[0].any() == (alive & known).any()
    assert known.any()


@dose(10)
@given(flights(farm_configs(SMALL)), stresses())
def test_an_area_that_covers_the_field_is_a_patch_that_lasts(flight: Flight, stress: StressConfig):
    """Whatever patches come, the field grows as one with the larger growth, and the team knows it from the start."""
    everywhere = ((-1.0, -1.0), (1000.0, -1.0), (1000.0, 1000.0), (-1.0, 1000.0))
    areas = ((stress.growth, everywhere), *((min(growth, stress.growth), c) for growth, c in stress.areas))
    one, two = (replace(stress, areas=areas, patches=patches) for patches in (stress.patches, 0))
    with_patches, without = (begin(replace(flight, config=stressed(flight.config, each))) for each in (one, two))
    for action in flight.actions():
        with_patches.step(action[None])
        without.step(action[None])
        assert (without.stressed == (stress.growth > 1)).all() or stress.growth == 1
        for name in ("aoi", "vdf", "reward"):
            np.testing.assert_array_equal(getattr(with_patches, name), getattr(without, name))


LEFT = ((0.0, 0.0), (100.0, 0.0), (100.0, 400.0), (0.0, 400.0))
LOWER = ((0.0, 0.0), (400.0, 0.0), (400.0, 100.0), (0.0, 100.0))


def test_counters_in_areas_rise_at_their_own_cycles_from_the_start():
    """Cycle 30 becomes 15 in the left quarter and 10 in the lower one, which wins where both are; a patch of 5 wins."""
    config = FarmConfig(
        stress=with_constants(
            StressConfig(patches=1, areas=((2, LEFT), (3, LOWER))), radius=1000.0, growth=5, seconds=60.0
        )
    )
    config = replace(config, camera=with_constants(config.camera, image_distance=1.0))
    farms = FarmBatch(config, 1)
    farms.reset(0, 3, 1)
    first, end = patches(config, 3, 1).time[0]
    cycles = np.full(farms.vdf[0].shape, 30)
    cycles[: len(cycles) // 4], cycles[:, : cycles.shape[1] // 4] = 15, 10
    assert np.array_equal(farms.known_cycles(0)[0], cycles.reshape(-1))
    assert np.array_equal(farms.stressed[0], cycles < 30)
    for step in range(1, 501):
        before = farms.vdf[0].copy()
        farms.step(np.zeros((1, 24), np.float32))
        due = step % (np.minimum(cycles, 6) if first <= step < end else cycles) == 0
        assert np.array_equal(farms.vdf[0], np.minimum(before + due, config.world.vdf_max))


def test_sensors_in_areas_have_their_own_cycles():
    """Which the team knows, and the observation shows areas as patches that are known."""
    config = stressed(FarmConfig(), StressConfig(areas=((4, LEFT),)))
    farms = FarmBatch(config, 1)
    farms.reset(0, 3, 1)
    layout = farms.layout(0)
    inside = layout.sensor_xy[:, 0] <= 100.0
    usual = layout.sensor_cycle_steps
    assert 0 < inside.sum() < len(inside)
    assert np.array_equal(farms.known_cycles(0)[1], np.where(inside, usual // 4, usual))
    seen = farms.observation[0, named_columns(config, "block_stress")]
    assert 0.0 < seen.mean() < 1.0
