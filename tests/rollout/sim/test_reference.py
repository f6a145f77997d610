"""The compiled farm against the reference farm over a long episode; test_properties_reference.py draws the switches."""

from dataclasses import replace

import numpy as np

from eia_sec.common.config import FarmConfig, WorldConfig
from eia_sec.common.config.presets import preset
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.layout import make_layout
from eia_sec.rollout.sim.reference.farm import ReferenceFarm

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
QUANTITIES = (
    "position",
    "aoi",
    "vdf",
    "link_quality",
    "service",
    "direction",
    "energy",
    "utility",
    "parts",
    "reward",
    "observation",
)


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
    """Random velocities that last for a while, so that UAVs spread and reach borders; some out of range."""
    random = np.random.default_rng(seed)
    action = np.empty((steps, 2 * config.world.uavs), np.float32)
    for step in range(steps):
        fresh = random.uniform(-1.2, 1.2, action.shape[1]) * (random.uniform(size=action.shape[1]) > 0.1)
        keep = random.uniform(size=action.shape[1]) < 0.9
        action[step] = np.where(keep & (step > 0), action[step - 1], fresh)
    return action


def test_a_long_episode_equals_the_reference():
    """Every quantity after every step, the very assignment, and the summary of it all."""
    batch, reference = pair(BASE, 3, 17)
    assert_equal(batch, reference)
    sums = np.zeros(5)
    returns = np.zeros(SMALL.uavs)
    for action in actions(BASE, SMALL.steps, 5):
        batch.step(action[None])
        reference.step(action)
        assert_equal(batch, reference)
        crowded, outside = reference.crowded.sum(), reference.outside.sum()
        sums += (reference.aoi.mean(), reference.vdf.mean(), crowded, outside, reference.energy.sum())
        returns += reference.reward
    summary = batch.summary(0)
    sums[:2] /= SMALL.steps
    counted = tuple(summary.metrics.values())
    np.testing.assert_allclose(counted, sums, rtol=1e-9)
    np.testing.assert_allclose(summary.reward, returns, rtol=1e-5, atol=1e-3)
    assert (summary.farm, summary.episode, summary.steps) == (3, 17, SMALL.steps)


def test_the_episodes_exercise_what_they_compare():
    """In the default variant there are deliveries, images, boundary violations, risk and motivation to compare."""
    batch, _ = pair(BASE, 3, 17)
    seen = np.zeros(batch.parts.shape[2])
    for action in actions(BASE, SMALL.steps, 5):
        batch.step(action[None])
        seen += np.abs(batch.parts[0]).sum(axis=0)
    assert (seen[:-1] > 0).all()  # nothing is relayed where links are not required
    assert batch.summary(0).metrics["boundary"] > 0


def test_sixty_four_of_each_type_equal_the_reference():
    """A full fleet on a wide farm, for a few steps."""
    world = WorldConfig(communication_uavs=64, monitoring_uavs=64, collection_uavs=64, start_levels="random")
    config = replace(preset("eia-sec").farm, world=world)
    batch, reference = pair(config, 0, 0)
    assert_equal(batch, reference)
    for action in actions(config, 4, 1):
        batch.step(action[None])
        reference.step(action)
        assert_equal(batch, reference)
