"""Heuristics in wind and around no-fly zones."""

from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.config import FarmConfig, WindConfig, WorldConfig, ZoneConfig
from eia_sec.common.config.farm import polygons
from eia_sec.common.config.presets import preset
from eia_sec.rollout.heuristics.detours import MARGIN, Airspace
from eia_sec.rollout.heuristics.registry import TASKS
from eia_sec.rollout.heuristics.steering import towards
from eia_sec.rollout.policies import policy_of
from eia_sec.rollout.sim.batch import REWARD_PARTS, FarmBatch
from eia_sec.rollout.sim.boxes import possible

BOUNDARY = REWARD_PARTS.index("boundary")
SEEN = preset("eia-sec").farm.observation
SHORT = FarmConfig(world=WorldConfig(steps=60, start_levels="random"), observation=SEEN)
ROOM = ((150.0, 100.0), (250.0, 100.0), (250.0, 300.0), (240.0, 300.0), (240.0, 110.0), (160.0, 110.0), (160.0, 300.0))
POCKET = (*ROOM, (150.0, 300.0))
"""A U, open to the north."""


def flown(name: str, config: FarmConfig, steps: int, seeds: tuple[int, int] = (1, 2)) -> tuple[FarmBatch, float]:
    """Fly a heuristic; return the batch and its boundary violations per UAV and step."""
    batch, policy, violations = FarmBatch(config, 1), policy_of(name, config), 0
    batch.reset(0, *seeds)
    policy.reset(batch, 0)
    for _ in range(steps):
        batch.step(policy.act(batch))
        violations += int((batch.parts[0, :, BOUNDARY] != 0.0).sum())
    return batch, violations / (steps * config.world.uavs)


@pytest.mark.parametrize("name", [*TASKS, "lawnmower+coverage"])
def test_no_heuristic_flies_against_a_zone(name):
    """Neither the given pocket nor two drawn rectangles ever refuse a move."""
    batch, violations = flown(name, replace(SHORT, zones=ZoneConfig((POCKET,), 2)), 60)
    assert violations == 0.0
    assert batch.utility[0, 4:].sum() >= 0.0


def test_the_way_out_of_a_pocket_leads_around_its_arms():
    """From inside the U to a place south of it: north first, around a tip, then down along its outside."""
    airspace = Airspace(SHORT, (np.array(POCKET),))
    position, goal, corners = np.array([200.0, 150.0]), np.array([200.0, 60.0]), []
    while (position != goal).any() and len(corners) < 10:
        position = airspace.waypoints(position[None], goal[None])[0]
        corners.append(position)
    assert len(corners) == 4
    assert corners[0][1] > 300.0
    assert corners[1][1] > 300.0
    assert corners[2][1] < 100.0
    assert np.abs(corners[0][0] - 200.0) == pytest.approx(40.0 - MARGIN / np.sqrt(2.0), abs=1e-6)
    assert airspace.detours(np.array([200.0, 150.0]), goal)
    assert not airspace.detours(np.array([200.0, 150.0]), np.array([200.0, 250.0]))


def test_a_goal_in_a_zone_becomes_the_nearest_place_outside():
    """And one behind a wall without a way around leaves a UAV where it is."""
    airspace = Airspace(SHORT, (np.array(POCKET),))
    (place,) = airspace.waypoints(np.array([[100.0, 200.0]]), np.array([[154.0, 200.0]]))
    assert place == pytest.approx([149.95, 200.0])
    wall = Airspace(SHORT, (np.array([(-1.0, 190.0), (401.0, 190.0), (401.0, 210.0), (-1.0, 210.0)]),))
    (place,) = wall.waypoints(np.array([[100.0, 100.0]]), np.array([[100.0, 300.0]]))
    assert place.tolist() == [100.0, 100.0]


def test_tours_leave_no_plot_out_that_is_not_in_a_zone():
    """In 400 steps the monitors serve all plots whose middle lies outside, around the zone and in its pocket."""
    config = replace(FarmConfig(), zones=ZoneConfig((POCKET,)), observation=SEEN)
    batch, policy = FarmBatch(config, 1), policy_of("lawnmower", config)
    batch.reset(0, 1, 2)
    policy.reset(batch, 0)
    served = np.zeros(batch.vdf[0].shape, bool)
    for _ in range(400):
        before = batch.vdf[0].copy()
        batch.step(policy.act(batch))
        served |= batch.vdf[0] < before
    middle = np.stack(np.meshgrid(*((np.arange(20) + 0.5) * 20.0,) * 2, indexing="ij"), axis=-1)
    outside = ~Airspace(config, (np.array(POCKET),)).inside(middle)
    assert served[outside].mean() > 0.97


def test_steering_allows_for_the_wind():
    """A command stays within what the top airspeed allows, and the way stays straight."""
    wind, position = np.array([0.6, -0.3]), np.zeros(2)
    low, high = possible(wind)
    np.testing.assert_allclose([low, high], [[-0.4, -1.0], [1.0, 0.7]])
    action = towards(position, np.array([-100.0, -100.0]), SHORT.world, wind)
    np.testing.assert_allclose(action, [-0.4, -0.4])
    np.testing.assert_allclose(towards(position, np.array([2.0, 3.0]), SHORT.world, wind), [0.2, 0.3])


def test_what_steering_commands_is_flown():
    """In a steady wind, every UAV makes over ground what was commanded, to the rounding of actions."""
    config = replace(SHORT, wind=WindConfig(speed=6.0))
    batch, policy = FarmBatch(config, 1), policy_of("greedy", config)
    batch.reset(0, 1, 2)
    policy.reset(batch, 0)
    for _ in range(30):
        before, action = batch.position[0].copy(), policy.act(batch)
        batch.step(action)
        np.testing.assert_allclose(batch.position[0] - before, 10.0 * action[0].reshape(-1, 2), atol=1e-5)


@pytest.mark.parametrize("name", ["lawnmower", "greedy", "horizon"])
def test_heuristics_earn_in_gusts(name):
    """Gusts of 2 m/s on 4 m/s of wind: no UAV is blown against the edge more than rarely."""
    config = replace(SHORT, wind=WindConfig(speed=4.0, gusts=2.0))
    batch, violations = flown(name, config, 60)
    assert violations < 0.02
    assert batch.summary(0).reward[4] > 0.0


@pytest.mark.parametrize("step", [0.0, 10.0])
def test_places_and_moves_are_judged_as_by_the_plain_geometry(step):
    """Compiled answers are those of `polygons`, on a grid whose places lie on borders and corners, too."""
    zones = (np.array(POCKET), np.array([(10.0, 10.0), (60.0, 20.0), (50.0, 70.0), (30.0, 40.0)]))
    airspace, draw = Airspace(SHORT, zones), np.random.default_rng(0)
    start, end = draw.uniform(0.0, 400.0, (2, 20_000, 2))
    if step:
        start, end = np.round(start / step) * step, np.round(end / step) * step
    end[::7] = start[::7]
    inside, refused = polygons.inside_any(start, zones), polygons.refused(start, end, zones)
    np.testing.assert_array_equal(airspace.inside(start), inside)
    np.testing.assert_array_equal(airspace.refused(start, end), refused)
    assert 500 < inside.sum() < 19_500
    assert 500 < refused.sum() < 19_500
    crossed = airspace.refused(start[:9, None], end[None, :8])
    np.testing.assert_array_equal(crossed, polygons.refused(start[:9, None], end[None, :8], zones))
    assert airspace.inside(start[0]).shape == ()
