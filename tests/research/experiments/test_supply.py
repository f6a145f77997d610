"""Where the supply goes."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from eia_sec.common.config.presets import PRESETS
from eia_sec.common.errors import ConfigError
from eia_sec.rollout.evaluation import episode_seed, record
from eia_sec.rollout.heuristics.registry import HEURISTICS
from eia_sec.rollout.policies import policy_of
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.layout import make_layout
from research.experiments.supply import COLUMNS, KINDS, SupplyLog, follow, main, mean, page
from tests.rollout.heuristics.small_farm import SMALL

FARM = replace(SMALL, observation=PRESETS["eia-sec"].farm.observation)


def test_every_unit_is_booked_once():
    """Four counters with a cycle of 2 and a cap of 1: served in time, at its rise, never, and at the cap."""
    ledger = SupplyLog(np.full(4, 2.0), 1.0, np.array([False, False, True, False]))
    courses = [[0, 1, 0, 1, 1, 1], [0, 0, 0, 1, 1, 1], [0, 1, 1, 1, 1, 1], [0, 1, 1, 0, 0, 1]]
    for step, level in enumerate(np.array(courses, float).T, 1):
        ledger.note(step, level, 1.0 if step in (3, 4) else 0.0)
    assert ledger.totals() == {"supply": 12.0, "paid": 2.0, "left": 4.0, "service": 1.0, "cap": 5.0, "border": 2.0}


def courses_of(name):
    """Return VDF of all plots, and AoI of all sensors, at the start and behind each step of farm 3's first episode."""
    batch, policy = FarmBatch(FARM, 1), policy_of(name, FARM)
    batch.reset(0, 3, episode_seed(3, 0))
    policy.reset(batch, 0)
    course = [(batch.vdf[0].reshape(-1).copy(), batch.aoi[0].copy())]
    while not batch.ended.all():
        batch.step(policy.act(batch))
        course.append((batch.vdf[0].reshape(-1).copy(), batch.aoi[0].copy()))
    return [np.stack(levels) for levels in zip(*course, strict=True)]


@pytest.mark.parametrize("name", ["lawnmower", "greedy", "static"])
def test_totals_are_what_a_recorded_episode_shows(name):
    """Counted from the course of the same episode: what was paid and left, rises at the cap, and rises while served."""
    totals, flown = follow(FARM, policy_of(name, FARM), 3), record(FARM, policy_of(name, FARM), 3, 0)
    world, collected = FARM.world, flown.collected[-1]
    steps = np.arange(1, world.steps + 1)[:, None]
    cycles = np.full(world.plots_x * world.plots_y, round(world.vdf_cycle)), make_layout(FARM, 3).sensor_cycle_steps
    first = world.communication_uavs + world.monitoring_uavs
    paid = collected[:first].sum(), collected[first:].sum()
    inside = np.zeros((world.plots_x, world.plots_y), bool)
    inside[1:-1, 1:-1] = True
    border = ~inside.reshape(-1), np.zeros(world.sensors, bool)
    most = world.vdf_max, world.aoi_max
    for kind, course, cycle, earned, edge, largest in zip(
        KINDS, courses_of(name), cycles, paid, border, most, strict=True
    ):
        due, full = steps % cycle == 0, course[:-1] >= largest
        assert totals[kind] == {
            "supply": due.sum(),
            "paid": earned,
            "left": course[-1].sum(),
            "service": (due & ~full & (course[1:] == 0)).sum(),
            "cap": (due & full).sum(),
            "border": (due & full)[:, edge].sum(),
        }


@pytest.mark.parametrize("name", HEURISTICS)
def test_nothing_is_lost_that_is_not_counted(name):
    """Of whoever flies nothing is negative, and who stands still loses most of it at the cap or leaves it."""
    found = mean(FARM, name, range(2))
    for kind in KINDS:
        own = found[kind]
        assert all(own[column] >= 0.0 for column in COLUMNS)
    if name == "static":
        assert found["VDF of plots"]["paid"] + found["VDF of plots"]["service"] < 0.1 * found["VDF of plots"]["supply"]
    text = page({"command": "x", "commit": "abc", "farms": [0, 1], "results": [found]})
    assert text.count(f"\n| {name} | ") == len(KINDS)


def test_counters_that_do_not_start_at_0_are_refused():
    """The sums would not say what they say."""
    with pytest.raises(ConfigError, match="start at 0"):
        mean(replace(SMALL, world=replace(SMALL.world, start_levels="random")), "static", range(1))


def test_the_command_prints_and_writes_the_same(tmp_path, monkeypatch, capsys):
    """One line of JSON with its origin, and in a folder that it makes the same data and their page."""
    folder = tmp_path / "new" / "supply"
    monkeypatch.setattr(sys, "argv", ["supply", "static", "--farms", "3:4", "--write", str(folder)])
    main()
    printed = json.loads(capsys.readouterr().out)
    assert (printed["farms"], [found["policy"] for found in printed["results"]]) == ([3], ["static"])
    assert "commit" in printed
    assert json.loads((folder / "results.json").read_text()) == printed
    assert (folder / "README.md").read_text() == page(printed)


@pytest.mark.parametrize("farms", ["3", "3:3", "4:3", "a:b", "-1:3", ""])
def test_farms_that_are_none_are_refused(farms, monkeypatch, capsys):
    """A range that holds no farm ends with code 2 and says what is asked for."""
    monkeypatch.setattr(sys, "argv", ["supply", "static", f"--farms={farms}"])
    with pytest.raises(SystemExit, match="2"):
        main()
    assert "A:B with whole numbers A < B" in capsys.readouterr().err
