"""Heuristics with batteries."""

from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.config import BatteryConfig, ZoneConfig
from eia_sec.common.config.farm.polygons import inside_any
from eia_sec.common.config.presets import preset
from eia_sec.rollout.heuristics.charging import FULL, Charging
from eia_sec.rollout.heuristics.registry import TASKS, heuristic
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.conditions.zones import make_zones
from eia_sec.rollout.sim.stations import station_places

PRESET = preset("battery").farm
FARM = replace(
    PRESET,
    battery=replace(PRESET.battery, failsafe=0.0),
    observation=replace(PRESET.observation, plan=0),  # plans would take most of the tests' time
)
FIRST = np.array([0])


def begun(farms):
    """Return the charging of a batch with one environment, in which nobody charges yet."""
    charging = Charging(farms.config)
    charging.reset(farms, 0)
    return charging


def redirected(charging, farms, goal):
    """Return the goals [n, 2] of all UAVs, who wanted to fly to (goal, goal)."""
    goals = np.full((1, 12, 2), goal)
    charging.redirect(farms, FIRST, goals)
    return goals[0]


@pytest.mark.parametrize("name", TASKS)
def test_nobody_runs_empty(name):
    """Every heuristic's UAVs charge in time, and more than once."""
    farms, policy = FarmBatch(FARM, 2), heuristic(name, FARM)
    for e in range(2):
        farms.reset(e, 500 + e, 0)
        policy.reset(farms, e)
    charged, before = np.zeros((2, 12)), farms.charge.copy()
    while not farms.ended.any():
        farms.step(policy.act(farms))
        charged += farms.charge > before
        before = farms.charge.copy()
    assert not farms.gone.any()
    assert (charged[:, 4:] > 5).all()


def test_uavs_of_a_type_take_different_stations_and_leave_when_full():
    """Two monitors at one place go to two stations; a full battery frees its station."""
    farms = FarmBatch(FARM, 1)
    farms.reset(0, 1, 1)
    farms.position[0, 4:6] = 110.0, 100.0
    farms.charge[0, 4:6] = 900.0
    charging, stations = begun(farms), station_places(FARM)
    goals = redirected(charging, farms, 7.0)
    taken = [int(np.flatnonzero((stations == goal).all(axis=1))[0]) for goal in goals[4:6]]
    assert len(set(taken)) == 2
    assert (goals[[0, 1, 6, 11]] == 7.0).all()
    farms.charge[0, 4:6] = FULL * FARM.battery.capacity - 1.0, FULL * FARM.battery.capacity
    goals = redirected(charging, farms, 7.0)
    assert (goals[4] == stations[taken[0]]).all()
    assert (goals[5] == 7.0).all()


def test_a_uav_that_is_gone_holds_no_station():
    """Its station is free for the next one."""
    farms = FarmBatch(replace(FARM, failures=replace(FARM.failures, at="monitoring 0 at 1")), 1)
    farms.reset(0, 1, 1)
    farms.charge[0, 4:6] = 100.0
    farms.position[0, 4:6] = 110.0, 100.0
    charging, stations = begun(farms), station_places(FARM)
    redirected(charging, farms, 0.0)
    farms.step(np.zeros((1, 24), np.float32))
    farms.charge[0, 6] = 100.0
    farms.position[0, 6] = stations[0]
    goals = redirected(charging, farms, 0.0)
    assert (goals[4] == 0.0).all()
    assert goals[6].any()


def test_drawn_zones_leave_the_stations_free():
    """On fifty farms no zone covers a station, and without batteries zones do not heed the places."""
    config = replace(FARM, zones=ZoneConfig(random=3))
    places = station_places(config)
    covered = [inside_any(places, make_zones(config, seed)).any() for seed in range(50)]
    assert not any(covered)
    plain = replace(config, battery=BatteryConfig())
    assert any(inside_any(places, make_zones(plain, seed)).any() for seed in range(50))


def test_a_station_in_a_zone_is_left_out():
    """UAVs fly to the next one, and nowhere if there is none."""
    around = [
        ((x - 9.0, y - 9.0), (x + 9.0, y - 9.0), (x + 9.0, y + 9.0), (x - 9.0, y + 9.0))
        for x, y in station_places(FARM)
    ]
    for zones in (around[:1], around):
        farms = FarmBatch(replace(FARM, zones=ZoneConfig(tuple(zones))), 1)
        farms.reset(0, 1, 1)
        farms.position[0, 4] = 85.0, 85.0
        farms.charge[0, 4] = 100.0
        goals = redirected(begun(farms), farms, 0.0)
        free = station_places(FARM)[len(zones) :]
        assert any((goals[4] == place).all() for place in free) == (len(free) > 0)
        assert goals[4].any() == (len(free) > 0)
