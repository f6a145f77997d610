"""Hindsight by hand: visits whose worth is counted in the head, and what tracking takes up."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.config import (
    CameraConfig,
    EnvConfig,
    FarmConfig,
    ObservationConfig,
    RadioConfig,
    RelayConfig,
    RunConfig,
    WorldConfig,
)
from eia_sec.rollout.envs.registry import make_environments
from eia_sec.rollout.sim.batch import FarmBatch
from tests.constants import with_constants

STEPS = 120
EVERYTHING = FarmConfig(
    world=WorldConfig(
        communication_uavs=1,
        monitoring_uavs=1,
        collection_uavs=1,
        field_x=40.0,
        field_y=40.0,
        plots_x=1,
        plots_y=1,
        sensors=1,
        sensor_cycles=(10,),
        vdf_cycle=10,
        steps=STEPS,
    ),
    radio=with_constants(RadioConfig(), sensor_power_dbm=90.0),
    observation=ObservationConfig(sensors=1),
    camera=with_constants(CameraConfig(), image_distance=1000.0, plot_threshold=1.0),
    relay=RelayConfig(require_link=True, link_range=20.0),
)
"""One UAV of each type, which serves its only plot or sensor in every step in which the relay is near."""


def served_at(steps: list[int], config: FarmConfig = EVERYTHING, batch: FarmBatch | None = None) -> FarmBatch:
    """Fly an episode in which everything is served at some steps and nothing at others."""
    batch = FarmBatch(config, 1, hindsight=True) if batch is None else batch
    batch.reset(0, 0, 0)
    batch.position[0, 1:] = 30.0
    for step in range(1, config.world.steps + 1):
        batch.position[0, 0] = 30.0 if step in steps else 0.0
        batch.step(np.zeros((1, 6), np.float32))
    return batch


def corrections(batch: FarmBatch) -> dict[int, tuple[float, float]]:
    """Return the monitor's and the collector's corrections in units, at the steps that have any."""
    assert batch.hindsight is not None
    reward, found = batch.config.reward, batch.hindsight[0]
    assert not found[:, 0].any()
    units = found[:, 1:] / (reward.monitoring, reward.collection)
    return {int(step) + 1: tuple(units[step].tolist()) for step in np.flatnonzero(found.any(axis=1))}


@pytest.mark.parametrize(
    ("steps", "wanted"),
    [
        ([], {}),
        ([35], {}),
        ([35, 75], {35: -1.0}),
        ([35, 55], {35: -3.0}),
        ([45, 99], {}),
        ([55, 57, 85], {55: -2.0}),
        ([35, 40, 55], {35: -4.0}),
        ([15, 20, 30, 45], {15: -3.0}),
        ([30, 45], {30: -3.0}),
    ],
)
def test_visits_are_worth_what_they_save_from_the_cap(steps, wanted):
    """The clocks tick every 10 steps up to 5; visits in between, twice at once, and in the very step of a tick."""
    flown = served_at(steps)
    assert corrections(flown) == {step: (units, units) for step, units in wanted.items()}


def test_a_correction_is_known_once_the_next_visit_happens():
    """Not before, and only in the step of the earlier visit."""
    batch = FarmBatch(EVERYTHING, 1, hindsight=True)
    short = replace(EVERYTHING, world=replace(EVERYTHING.world, steps=54))
    assert not corrections(served_at([35, 55], short))
    assert corrections(served_at([35, 55], batch=batch)) == {35: (-3.0, -3.0)}


def test_a_reset_forgets_visits_and_corrections():
    """A visit of the last episode has no successor in the next one; other environments keep theirs."""
    batch = served_at([35, 55])
    assert not corrections(served_at([75], batch=batch))
    farms = FarmBatch(FarmConfig(world=WorldConfig(steps=60, start_levels="random")), 2, hindsight=True)
    for index in range(2):
        farms.reset(index, index, 0)
    for _ in range(60):
        farms.step(np.zeros((2, 24), np.float32))
    assert farms.hindsight is not None
    kept = farms.hindsight[1].copy()
    farms.reset(0, 0, 1)
    assert kept.any()
    assert not farms.hindsight[0].any()
    assert np.array_equal(farms.hindsight[1], kept)


def test_copies_and_threads_track_alike():
    """A copy made in the middle of an episode and a batch of two threads find the same corrections."""
    config = FarmConfig(world=WorldConfig(steps=80, start_levels="random"))
    one, two = FarmBatch(config, 4, hindsight=True), FarmBatch(config, 4, 2, hindsight=True)
    action = np.random.default_rng(0).uniform(-1.0, 1.0, (80, 4, 24)).astype(np.float32)
    for batch in (one, two):
        for index in range(4):
            batch.reset(index, index, 0)
    for step in range(40):
        one.step(action[step])
        two.step(action[step])
    twin = copy.deepcopy(one)
    for step in range(40, 80):
        for batch in (one, two, twin):
            batch.step(action[step])
    assert np.abs(one.hindsight).max() > 0.0
    assert np.array_equal(one.hindsight, two.hindsight)
    assert np.array_equal(one.hindsight, twin.hindsight)


def test_nothing_is_allocated_unless_visits_are_tracked():
    """Tracking takes 4 bytes for each step and UAV and 16 for each plot and sensor; without it nothing."""
    world = WorldConfig()
    for tracked in (False, True):
        batch = FarmBatch(FarmConfig(), 3, hindsight=tracked)
        state = batch._state
        taken = [array.nbytes for array in (state.hindsight, state.plot_visit, state.sensor_visit)]
        plots = world.plots_x * world.plots_y
        assert taken == [3 * tracked * 4 * number for number in (world.steps * 12, 4 * plots, 4 * world.sensors)]
        assert (batch.hindsight is None) == (not tracked)


def test_runs_track_only_what_they_ask_for():
    """`make_environments` passes it on; a PettingZoo environment has none."""
    tracked = make_environments(RunConfig(farm=EVERYTHING), 2, hindsight=True)
    assert tracked.hindsight is not None
    assert tracked.hindsight.shape == (2, STEPS, 3)
    assert make_environments(RunConfig(farm=EVERYTHING), 2).hindsight is None
    toy = RunConfig(env=EnvConfig(name="tests.rollout.envs.toy_env:Relay"))
    assert make_environments(toy, 2, hindsight=True).hindsight is None
