"""Farms with autopilots that watch the batteries."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.config import BatteryConfig, FailureConfig, WindConfig, ZoneConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError, SimulationError
from eia_sec.rollout.heuristics.charging import FULL
from eia_sec.rollout.heuristics.failsafe import FailsafeFarms
from eia_sec.rollout.heuristics.farms import make_farms
from eia_sec.rollout.sim.batch import REWARD_PARTS, FarmBatch
from eia_sec.rollout.sim.layout import make_layout
from eia_sec.rollout.sim.start import start_levels, start_positions
from eia_sec.rollout.sim.stations import station_places
from tests.rollout.sim.properties.strategies import placed

SEARCHING = preset("battery").farm
PLAIN = replace(
    SEARCHING,
    battery=replace(SEARCHING.battery, failsafe=0.0),
    observation=replace(SEARCHING.observation, plan=0),
)
"""Without plans, which would take most of the tests' time."""
WATCHED = replace(PLAIN, battery=replace(PLAIN.battery, failsafe=0.2))
WINDY = replace(WATCHED, wind=WindConfig(speed=2.0, gusts=1.0), zones=ZoneConfig(random=3))


def begun(config, environments=2):
    """Return farms at the start of an episode."""
    farms = make_farms(config, environments)
    for e in range(environments):
        farms.reset(e, 500 + e, e)
    return farms


def drift(rng, environments=2):
    """Return random actions."""
    return np.clip(rng.normal(0.0, 1.0, (environments, 24)), -1.0, 1.0).astype(np.float32)


def from_station(farms, e, u):
    """Return how far a UAV is from the nearest station, m."""
    return np.linalg.norm(station_places(farms.config) - farms.position[e, u], axis=1).min()


@pytest.mark.parametrize("config", [WATCHED, WINDY], ids=["calm", "wind and zones"])
def test_nobody_runs_empty_whatever_the_policy_does(config):
    """UAVs that fly at random, and those that stand still, live to the end; without autopilots they do not."""
    ends = {}
    for watched in (True, False):
        farms, rng = begun(config if watched else replace(config, battery=PLAIN.battery)), np.random.default_rng(3)
        while not farms.ended.any():
            if farms.time[0] % 10 == 0:
                action = drift(rng)
                action[:, ::6] = action[:, 1::6] = 0.0
            farms.step(action)
        ends[watched] = farms.gone.sum()
    assert ends == {True: 0, False: 24}


def test_with_charge_left_uavs_fly_as_commanded():
    """Until somebody is due, positions and observations are those of farms without autopilots, bit for bit."""
    watched, plain, rng = begun(WATCHED), FarmBatch(PLAIN, 2), np.random.default_rng(5)
    for e in range(2):
        plain.reset(e, 500 + e, e)
    for _ in range(60):
        action = drift(rng)
        watched.step(action)
        plain.step(action)
        np.testing.assert_array_equal(watched.position, plain.position)
        np.testing.assert_array_equal(watched.observation, plain.observation)
    farms = watched
    farms.charge[0, 5] = 0.2 * WATCHED.battery.capacity
    before = farms.position.copy()
    action = drift(rng)
    farms.step(action)
    plain.step(action)
    moved = (farms.position != plain.position).any(axis=-1)
    assert moved[0, 5]
    assert moved.sum() == 1
    goals = station_places(farms.config)
    ways = [np.linalg.norm(goals - place, axis=1).min() for place in (before[0, 5], farms.position[0, 5])]
    assert ways[1] < ways[0] - 5.0


def test_a_uav_charges_until_it_is_nearly_full():
    """It lands, its charge rises in every step, and then the policy's commands count again."""
    farms = begun(WATCHED, 1)
    farms.charge[0, 9] = 0.15 * WATCHED.battery.capacity
    away = np.ones((1, 24), np.float32)
    for _ in range(40):
        farms.step(away)
        if from_station(farms, 0, 9) < 1e-3:
            break
    full = FULL * WATCHED.battery.capacity
    steps = 0
    while farms.charge[0, 9] < full:
        before, place = farms.charge[0, 9], farms.position[0, 9].copy()
        farms.step(away)
        assert farms.charge[0, 9] > before
        assert np.linalg.norm(farms.position[0, 9] - place) < 1e-3
        steps += 1
    assert 10 < steps < 30
    place = farms.position[0, 9].copy()
    farms.step(-away)
    assert (farms.position[0, 9] < place - 1.0).all()


def leg(config, share, command=0.0):
    """Return the places [30, 2] m of a collector on its way to a station, and the place at which another one begins.

    Args:
        config: the farm.
        share: of the capacity that the collector has.
        command: what the other one, who begins in the way, is commanded along x in the first step.
    """
    x, y = station_places(config)[0]
    collectors = (x + 80.0, y + 3.0), (x + 40.0, y), (x, y + 200.0), (x + 200.0, y)
    place = np.concatenate([start_positions(config.world, 500, 0)[:8], collectors])
    farms, way = make_farms(config, 1), []
    with placed(make_layout(config, 500), place, start_levels(config.world, 500, 0)):
        farms.reset(0, 500, 0)
    farms.charge[0, 8] = share * config.battery.capacity
    action = np.zeros((1, 24), np.float32)
    action[0, 18] = command
    for _ in range(30):
        farms.step(action)
        way.append(farms.position[0, 8].copy())
        action[:] = 0.0
    assert np.linalg.norm(way[-1] - (x, y)) < 1.0
    return np.array(way), np.array(collectors[1])


def nearest(way, place):
    """Return how near a way comes to a place, m."""
    return np.linalg.norm(way - place, axis=1).min()


def test_autopilots_keep_apart_while_there_is_charge_to_spare():
    """One that hovers in the way is flown around; where less than half of the reserve would be left, it is not."""
    assert nearest(*leg(WATCHED, 0.15)) < 10.0
    assert nearest(*leg(WATCHED, 0.25)) > WATCHED.world.safety_distance - 4.0


def test_autopilots_reckon_with_what_others_can_fly():
    """A command of ten times full speed is flown as one of full speed, so the way is the same."""
    np.testing.assert_array_equal(leg(WATCHED, 0.25, 10.0)[0], leg(WATCHED, 0.25, 1.0)[0])


def test_autopilots_do_not_fly_around_uavs_that_are_gone():
    """A UAV that has failed is in nobody's way, whatever charge is left."""
    gone = replace(WATCHED, failures=FailureConfig(at="collection 1 at 1"))
    assert nearest(*leg(gone, 0.25)) < 10.0


def test_autopilots_fly_around_zones():
    """A UAV behind a zone reaches its station without a refused move."""
    start = begun(WATCHED, 1).position[0, 6]
    stations = station_places(WATCHED)
    station = stations[np.linalg.norm(stations - start, axis=1).argmin()]
    x, y = (start + station) / 2.0
    wall = ((x - 8.0, y - 8.0), (x + 8.0, y - 8.0), (x + 8.0, y + 8.0), (x - 8.0, y + 8.0))
    farms = begun(replace(WATCHED, zones=ZoneConfig((wall,))), 1)
    np.testing.assert_array_equal(farms.position[0, 6], start)
    assert np.linalg.norm(station - start) > 30.0
    farms.charge[0, 6] = 0.1 * WATCHED.battery.capacity
    straight = True
    for _ in range(40):
        farms.step(np.zeros((1, 24), np.float32))
        assert farms.parts[0, 6, REWARD_PARTS.index("boundary")] == 0.0
        way = farms.position[0, 6] - start
        straight &= abs((station - start)[0] * way[1] - (station - start)[1] * way[0]) < 1.0
        if np.linalg.norm(farms.position[0, 6] - station) < 1e-3:
            break
    np.testing.assert_allclose(farms.position[0, 6], station, atol=1e-3)
    assert not straight


def test_environments_are_independent():
    """One environment of a batch flies as it does alone, after another one was begun anew."""
    rng = np.random.default_rng(9)
    both, alone = begun(WATCHED), make_farms(WATCHED, 1)
    alone.reset(0, 501, 1)
    for step in range(300):
        if step == 150:
            both.reset(0, 7, 7)
        action = drift(rng)
        both.step(action)
        alone.step(action[1:])
        np.testing.assert_array_equal(both.position[1], alone.position[0])
    assert (both.charge[1] > 0.0).all()


def test_who_makes_which_farms():
    """Autopilots fly where they are asked for, and the simulator alone refuses."""
    assert type(make_farms(WATCHED, 1)) is FailsafeFarms
    assert type(make_farms(PLAIN, 1)) is FarmBatch
    without = replace(WATCHED, battery=replace(WATCHED.battery, capacity=0.0))
    assert type(make_farms(without, 1)) is FarmBatch
    with pytest.raises(SimulationError, match=r"farm\.battery\.failsafe are made by"):
        FarmBatch(WATCHED, 1)


def test_malformed_actions_are_refused_as_ever():
    """A wrong shape, a number that is not finite, and a step before the first reset."""
    farms = begun(WATCHED, 1)
    with pytest.raises(SimulationError, match="actions are"):
        farms.step(np.zeros((1, 23), np.float32))
    with pytest.raises(SimulationError, match="not finite"):
        farms.step(np.full((1, 24), np.nan, np.float32))
    with pytest.raises(SimulationError, match="before its reset"):
        make_farms(WATCHED, 1).step(np.zeros((1, 24), np.float32))


def test_a_refused_step_changes_nothing():
    """Not even who is on the way to a station, or where; a charging UAV's number counts as anybody's."""
    farms, twin = begun(WATCHED, 1), begun(WATCHED, 1)
    for batch in (farms, twin):
        batch.charge[0, 5] = 0.15 * WATCHED.battery.capacity
    for column in (10, 0):  # of the charging UAV, and of another
        bad = np.zeros((1, 24), np.float32)
        bad[0, column] = np.nan
        with pytest.raises(SimulationError, match="not finite"):
            farms.step(bad)
    # Elsewhere and nearly full: whoever had taken a station then would go on to it.
    for batch in (farms, twin):
        batch.charge[0, 5] = 0.6 * WATCHED.battery.capacity
        batch.step(np.ones((1, 24), np.float32))
    np.testing.assert_array_equal(farms.position, twin.position)


def test_without_a_free_station_the_policy_flies_on():
    """Of five monitors that are due only four are redirected; where zones cover every station, nobody is."""
    many = replace(WATCHED, world=replace(WATCHED.world, monitoring_uavs=5))
    around = tuple(
        ((x - 9.0, y - 9.0), (x + 9.0, y - 9.0), (x + 9.0, y + 9.0), (x - 9.0, y + 9.0))
        for x, y in station_places(WATCHED)
    )
    for config, redirected in ((many, 4), (replace(many, zones=ZoneConfig(around)), 0)):
        farms = begun(config, 1)
        farms.charge[0, 4:9] = 0.1 * config.battery.capacity
        before = farms.position.copy()
        farms.step(np.zeros((1, 26), np.float32))
        assert (farms.position != before).any(axis=-1)[0, 4:9].sum() == redirected


def test_threads_and_copies_fly_alike():
    """Two threads equal one, and a deep copy goes on as the original does."""
    rng, one, two = np.random.default_rng(11), begun(WATCHED), make_farms(WATCHED, 2, threads=2)
    for e in range(2):
        two.reset(e, 500 + e, e)
    for batch in (one, two):
        batch.charge[:, 4:6] = 0.2 * WATCHED.battery.capacity
    for step in range(30):
        if step == 5:
            copied = copy.deepcopy(one)
        action = drift(rng)
        for batch in (one, two, *([copied] if step >= 5 else [])):
            batch.step(action)
        np.testing.assert_array_equal(one.position, two.position)
        if step >= 5:
            np.testing.assert_array_equal(one.position, copied.position)


@pytest.mark.parametrize("share", [-0.1, 0.81, float("nan")])
def test_a_reserve_is_a_share(share):
    """One that would keep UAVs at their stations is refused."""
    with pytest.raises(ConfigError, match=r"failsafe must be between 0\.0 and 0\.8"):
        BatteryConfig(capacity=8000.0, failsafe=share)
