"""Heuristics whose UAVs have inertia: the motion that they reckon with, steering that stops, and whole flights."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from eia_sec.common.config.presets import preset
from eia_sec.rollout.evaluation import evaluate
from eia_sec.rollout.heuristics.inertia import Inertia, glide, rest_seconds
from eia_sec.rollout.heuristics.tasks.horizon import image_table
from eia_sec.rollout.heuristics.tasks.lawnmower import straight_routes
from eia_sec.rollout.policies import policy_of
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.core.dynamics import glide as compiled_glide
from eia_sec.rollout.sim.sweep_routes import plot_qualities
from tests.rollout.sim.properties.strategies import dose

FARM = preset("inertial").farm
ALL = Inertia(FARM, np.repeat((0, 1, 2), FARM.world.counts))
SPEED = np.array([FARM.world.speed_x_max, FARM.world.speed_y_max])


@dose(100)
@given(st.floats(-9, 9), st.floats(-3, 3), st.floats(-9, 9), st.floats(0.0, 9.0))
def test_the_motion_of_heuristics_is_that_of_the_farm(v: float, a: float, wanted: float, seconds: float):
    """The same closed form, for many at once."""
    arrays = (np.array([value]) for value in (v, a, wanted))
    found = glide(*arrays, np.array([3.0]), np.array([4.0]), seconds)
    np.testing.assert_allclose(np.ravel(found), compiled_glide(v, a, wanted, 3.0, 4.0, seconds), rtol=1e-9, atol=1e-9)


def test_steering_stops_at_the_goal_without_overshoot():
    """From any motion: after 25 steps every UAV stands at its goal, and none that began at rest was ever beyond it."""
    batch = FarmBatch(FARM, 1)
    batch.reset(0, 0, 0)
    random = np.random.default_rng(1)
    for begin in range(2):
        batch.position[0] = 200.0 + random.uniform(-60.0, 60.0, (12, 2))
        batch.motion[0] = 0.0
        if begin:
            for _ in range(3):
                batch.step(random.uniform(-1.0, 1.0, (1, 24)).astype(np.float32))
        start = batch.position[0].copy()
        goal = 200.0 + random.uniform(-60.0, 60.0, (12, 2))
        for _ in range(25):
            action = ALL.steer(batch.motion[0], goal - batch.position[0]) / SPEED
            batch.step(action.astype(np.float32).reshape(1, -1))
            beyond = (batch.position[0] - goal) * np.sign(goal - start)
            assert begin or (beyond < 0.05).all()
        np.testing.assert_allclose(batch.position[0], goal, atol=0.05)


@pytest.mark.parametrize("way", [0.5, 5.0, 20.0, 60.0, 200.0])
def test_ways_take_the_time_that_is_reckoned(way: float):
    """Steered from rest, a UAV arrives within the reckoned time and the two steps that commands a second apart cost."""
    batch = FarmBatch(FARM, 1)
    batch.reset(0, 0, 0)
    batch.position[0], steps = (100.0, 200.0), 0
    while abs(batch.position[0, 0, 0] - 100.0 - way) > 0.3:
        action = ALL.steer(batch.motion[0], (100.0 + way, 200.0) - batch.position[0]) / SPEED
        batch.step(action.astype(np.float32).reshape(1, -1))
        steps += 1
    reckoned = float(rest_seconds(np.array(way), 3.0, 4.0, 0.1, 8.4))
    assert reckoned - 1.5 <= steps <= reckoned + 3.0


def test_sweeps_are_straight():
    """A monitor's lanes end in turns at the far and the near side; two laps fly each of its columns both ways."""
    for route in straight_routes(FARM):
        places = route.mean(axis=0)
        assert places[:, 1].tolist() == [390.0, 10.0] * 5
        assert np.diff(np.sort(places[:, 0])).tolist() == [0.0, 20.0] * 4 + [0.0]
        assert np.abs(np.diff(places[:, 0])).max() <= 40.0


def test_horizon_knows_from_where_images_succeed():
    """The table of the search agrees with the camera at places all over a plot."""
    table, far = image_table(FARM)
    places = np.random.default_rng(0).uniform(-10.0, 10.0, (200, 2))
    cells = np.minimum((np.abs(places) * len(table) / far).astype(int), len(table) - 1)
    known = table[cells[:, 0], cells[:, 1]] * (np.abs(places) < far).all(axis=1)
    assert (known == (plot_qualities(FARM, places) >= FARM.camera.plot_threshold)).mean() > 0.97


@pytest.mark.parametrize(("name", "least"), [("lawnmower", 280), ("greedy", 150), ("horizon", 320)])
def test_heuristics_know_the_inertia(name: str, least: float):
    """On half an episode they earn what they did when this was written less a margin, and hardly hit the border."""
    farm = replace(FARM, world=replace(FARM.world, steps=250))
    total = evaluate(farm, policy_of(name, farm), range(100, 102), 1, name=name).total
    assert total.reward > least
    assert total.metrics["boundary"] < 3.0
