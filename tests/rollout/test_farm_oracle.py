"""The compiled farm against the reference farm, quantity by quantity, under every switch."""

from dataclasses import replace

import numpy as np
import pytest

from common.config import (
    CameraConfig,
    EnergyConfig,
    FarmConfig,
    ObservationConfig,
    RadioConfig,
    RelayConfig,
    RewardConfig,
    WorldConfig,
)
from rollout.farms import FarmBatch
from rollout.layout import make_layout
from rollout.reference import ReferenceFarm

SMALL = WorldConfig(
    communication_uavs=2,
    monitoring_uavs=3,
    collection_uavs=3,
    field_x=170.0,
    field_y=130.0,
    sensors=70,
    plots_x=9,
    plots_y=7,
    sensor_cycles=(4, 5, 6),
    vdf_cycle=3,
    steps=160,
)
BASE = FarmConfig(world=SMALL)
QUANTITIES = ("position", "aoi", "vdf", "service", "direction", "energy", "utility", "parts", "reward", "observation")


def world(**changes) -> FarmConfig:
    return replace(BASE, world=replace(SMALL, **changes))


VARIANTS = {
    "default": BASE,
    "physical energy": replace(BASE, energy=EnergyConfig(model="physical")),
    "printed positioning sign": replace(BASE, reward=RewardConfig(positioning_sign="printed")),
    "printed risk": replace(BASE, reward=RewardConfig(risk="printed")),
    "nearest in any plane": replace(BASE, reward=RewardConfig(nearest="any")),
    "printed risk in any plane": replace(BASE, reward=RewardConfig(nearest="any", risk="printed")),
    "ghz": replace(BASE, radio=RadioConfig(frequency_unit="ghz", sensor_power_dbm=-60.0)),
    "interference": replace(BASE, radio=RadioConfig(interference=True)),
    "interference, exact Q": replace(BASE, radio=RadioConfig(interference=True, q_function="exact")),
    "exact Q": replace(BASE, radio=RadioConfig(q_function="exact")),
    "expected delivery": replace(BASE, radio=RadioConfig(delivery="expected")),
    "vegetation thinning out": replace(BASE, radio=RadioConfig(vegetation_distance_exponent=-0.2)),
    "require link": replace(BASE, relay=RelayConfig(require_link=True, link_range=60.0)),
    "random start levels": world(start_levels="random"),
    "random phases": world(cycle_phase="random"),
    "random levels, phases and expected delivery": replace(
        world(start_levels="random", cycle_phase="random"), radio=RadioConfig(delivery="expected")
    ),
    "printed observation": replace(BASE, observation=ObservationConfig(form="printed")),
    "nearest sensors observed": replace(BASE, observation=replace(BASE.observation, choice="nearest")),
    "all sensors observed": replace(BASE, observation=ObservationConfig(sensors=70)),
    "capacity of all": replace(BASE, relay=RelayConfig(capacity=6)),
    "capacity and weights": replace(
        world(communication_uavs=4),
        relay=RelayConfig(capacity=3, cost_distance=0.2, cost_link=2.0, weight_farthest=0.7, weight_relays=0.0),
    ),
    "indifferent cost": replace(BASE, relay=RelayConfig(capacity=4, cost_distance=0.0, cost_link=0.0)),
    "one relay": world(communication_uavs=1),
    "one monitoring UAV": world(monitoring_uavs=1),
    "one of each": world(communication_uavs=1, monitoring_uavs=1, collection_uavs=1),
    "more relays than served": world(communication_uavs=5, monitoring_uavs=1, collection_uavs=2),
    "unequal numbers": world(communication_uavs=3, monitoring_uavs=5, collection_uavs=2),
    "half-second steps": world(step_seconds=0.5, speed_x_max=6.0),
    "every plot succeeds": replace(BASE, camera=CameraConfig(plot_threshold=0.0)),
    "camera below its height": replace(BASE, camera=CameraConfig(image_distance=19.0)),
    "coarse and wide camera": replace(
        BASE, camera=CameraConfig(image_distance=60.0, grid_x=2, grid_y=3, plot_threshold=1.0)
    ),
    "one plot, few sensors": replace(
        BASE, world=replace(SMALL, plots_x=1, plots_y=1, sensors=3), observation=ObservationConfig(sensors=2)
    ),
    "planes of one height": world(height_communication=20.0, height_collection=20.0),
}


def pair(config: FarmConfig, farm_seed: int, episode_seed: int) -> tuple[FarmBatch, ReferenceFarm]:
    batch = FarmBatch(config, 1)
    batch.reset(0, farm_seed, episode_seed)
    return batch, ReferenceFarm(config, make_layout(config, farm_seed), episode_seed)


def assert_equal(batch: FarmBatch, reference: ReferenceFarm) -> None:
    assert batch.time[0] == reference.time
    np.testing.assert_array_equal(batch.assignment[0], reference.assignment)
    for name in QUANTITIES:
        # Float32 results are compared to float32's resolution.
        rough = name in {"reward", "observation"}
        np.testing.assert_allclose(
            getattr(batch, name)[0],
            getattr(reference, name),
            rtol=1e-6 if rough else 1e-9,
            atol=1e-6 if rough else 1e-9,
            err_msg=f"{name} at step {reference.time}",
        )


def actions(config: FarmConfig, steps: int, seed: int) -> np.ndarray:
    """Random velocities that last for a while, so that UAVs get about and run into borders; some out of range."""
    random = np.random.default_rng(seed)
    action = np.empty((steps, 2 * config.world.uavs), np.float32)
    for step in range(steps):
        fresh = random.uniform(-1.2, 1.2, action.shape[1]) * (random.uniform(size=action.shape[1]) > 0.1)
        keep = random.uniform(size=action.shape[1]) < 0.9
        action[step] = np.where(keep & (step > 0), action[step - 1], fresh)
    return action


@pytest.mark.parametrize("name", VARIANTS)
def test_an_episode_equals_the_reference(name):
    """Every quantity after every step of a random episode, and the summary of it."""
    config = VARIANTS[name]
    batch, reference = pair(config, 3, 17)
    assert_equal(batch, reference)
    sums = np.zeros(5)
    returns = np.zeros(config.world.uavs)
    for action in actions(config, config.world.steps, 5):
        batch.step(action[None])
        reference.step(action)
        assert_equal(batch, reference)
        crowded, outside = reference.crowded.sum(), reference.outside.sum()
        sums += (reference.aoi.mean(), reference.vdf.mean(), crowded, outside, reference.energy.sum())
        returns += reference.reward
    summary = batch.summary(0)
    sums[:2] /= config.world.steps
    counted = (summary.aoi, summary.vdf, summary.collisions, summary.boundary, summary.energy_j)
    np.testing.assert_allclose(counted, sums, rtol=1e-9)
    np.testing.assert_allclose(summary.reward, returns, rtol=1e-5, atol=1e-3)
    assert (summary.farm, summary.episode, summary.steps) == (3, 17, config.world.steps)


def test_the_episodes_exercise_what_they_compare():
    """In the default variant there are deliveries, images, boundary violations, risk and motivation to compare."""
    batch, _ = pair(BASE, 3, 17)
    seen = np.zeros(batch.parts.shape[2])
    for action in actions(BASE, SMALL.steps, 5):
        batch.step(action[None])
        seen += np.abs(batch.parts[0]).sum(axis=0)
    assert (seen > 0).all()
    assert batch.summary(0).boundary > 0


@pytest.mark.parametrize(
    "name", ["default", "interference", "require link", "nearest in any plane", "expected delivery"]
)
def test_random_states_equal_the_reference(name):
    """UAVs put anywhere, also onto one another, into corners and onto borders of plots."""
    config = VARIANTS[name]
    batch, reference = pair(config, 4, 1)
    random = np.random.default_rng(2)
    size = np.array([SMALL.field_x, SMALL.field_y])
    for trial in range(60):
        place = random.uniform(0.0, size, (SMALL.uavs, 2))
        if trial % 3 == 1:
            place = random.integers(0, 3, place.shape) / 2.0 * size
        if trial % 3 == 2:
            place = place[random.integers(0, 3, SMALL.uavs)]
        batch.position[0], reference.position = place, place.copy()
        action = random.uniform(-1.0, 1.0, 2 * SMALL.uavs).astype(np.float32) * (trial % 2)
        batch.step(action[None])
        reference.step(action, batch.assignment[0])
        np.testing.assert_allclose(
            reference.assignment_costs()[np.arange(6), batch.assignment[0]].sum(), reference.assignment_cost, atol=1e-9
        )
        assert_equal(batch, reference)


def test_sixty_four_of_each_type_equal_the_reference():
    """A full fleet on a wide farm, for a few steps."""
    config = FarmConfig(
        world=WorldConfig(communication_uavs=64, monitoring_uavs=64, collection_uavs=64, start_levels="random")
    )
    batch, reference = pair(config, 0, 0)
    assert_equal(batch, reference)
    for action in actions(config, 4, 1):
        batch.step(action[None])
        reference.step(action)
        assert_equal(batch, reference)


def test_the_reward_is_the_sum_of_its_parts():
    """Exactly, up to the rounding to float32."""
    batch, _ = pair(BASE, 1, 1)
    for action in actions(BASE, 50, 3):
        batch.step(action[None])
        np.testing.assert_array_equal(batch.reward, batch.parts.sum(axis=2).astype(np.float32))
