"""Where the supply goes."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from common.config.presets import PRESETS
from common.errors import ConfigError
from experiments.supply import COLUMNS, KINDS, Ledger, follow, main, mean, page
from rollout.evaluation import episode_seed, record
from rollout.farms import FarmBatch
from rollout.policies import HEURISTICS, policy_of
from tests.rollout.small_farm import SMALL

FARM = replace(SMALL, observation=PRESETS["default"].farm.observation)


def test_every_unit_is_booked_once():
    """Four counters with a cycle of 2 and a cap of 1: served in time, at its rise, never, and at the cap."""
    ledger = Ledger(np.full(4, 2.0), 1.0, np.array([False, False, True, False]))
    courses = [[0, 1, 0, 1, 1, 1], [0, 0, 0, 1, 1, 1], [0, 1, 1, 1, 1, 1], [0, 1, 1, 0, 0, 1]]
    for step, level in enumerate(np.array(courses, float).T, 1):
        ledger.note(step, level, 1.0 if step in (3, 4) else 0.0)
    assert ledger.told() == {"supply": 12.0, "paid": 2.0, "left": 4.0, "service": 1.0, "cap": 5.0, "border": 2.0}


def plots_of(name):
    """Return the VDF of all plots at the start and behind each step of the first episode of farm 3."""
    batch, policy = FarmBatch(FARM, 1), policy_of(name, FARM)
    batch.reset(0, 3, episode_seed(3, 0))
    policy.reset(batch, 0)
    course = [batch.vdf[0].copy()]
    while not batch.ended.all():
        batch.step(policy.act(batch))
        course.append(batch.vdf[0].copy())
    return np.stack(course)


@pytest.mark.parametrize("name", ["lawnmower", "greedy", "static"])
def test_what_is_told_is_what_a_recorded_episode_shows(name):
    """Counted from the course of the same episode: what was paid and left, rises at the cap, and rises while served."""
    told, flown = follow(FARM, policy_of(name, FARM), 3), record(FARM, policy_of(name, FARM), 3, 0)
    world, (plots, sensors), course = FARM.world, KINDS, plots_of(name)
    due = np.arange(1, world.steps + 1) % round(world.vdf_cycle / world.step_seconds) == 0
    before, after = course[:-1][due], course[1:][due]
    inside = np.zeros((world.plots_x, world.plots_y), bool)
    inside[1:-1, 1:-1] = True
    full = before >= world.vdf_max
    assert told[plots]["cap"] == full.sum()
    assert told[plots]["border"] == full[:, ~inside].sum()
    assert told[plots]["service"] == ((after == 0) & ~full).sum()
    assert told[plots]["left"] == flown.final_vdf.sum()
    assert told[sensors]["left"] == flown.final_aoi.sum()
    collected, first = flown.collected[-1], world.communication_uavs + world.monitoring_uavs
    assert (told[plots]["paid"], told[sensors]["paid"]) == (collected[:first].sum(), collected[first:].sum())


@pytest.mark.parametrize("name", HEURISTICS)
def test_nothing_is_lost_that_is_not_told(name):
    """Of whoever flies nothing is negative, and who stands still loses most of it at the cap or leaves it."""
    found = mean(FARM, name, range(2))
    for kind in KINDS:
        own = found[kind]
        assert all(own[column] >= 0.0 for column in COLUMNS)
    if name == "static":
        assert found["VDF of plots"]["paid"] + found["VDF of plots"]["service"] < 0.1 * found["VDF of plots"]["supply"]
    text = page({"command": "x", "commit": "abc", "farms": [0, 1], "results": [found]})
    assert text.count(f"\n| {name} | ") == len(KINDS)


def test_other_cycles_are_refused():
    """Where counters rise at other times than multiples of their cycles, the sums would not say what they say."""
    with pytest.raises(ConfigError, match="multiples of their cycles"):
        mean(replace(SMALL, world=replace(SMALL.world, start_levels="random")), "static", range(1))


def test_the_command_prints_and_writes_the_same(tmp_path, monkeypatch, capsys):
    """One line of JSON with its origin, and in a folder that it makes the same data and their page."""
    folder = tmp_path / "new" / "supply"
    monkeypatch.setattr(sys, "argv", ["supply", "static", "--farms", "3:4", "--write", str(folder)])
    main()
    told = json.loads(capsys.readouterr().out)
    assert (told["farms"], [found["policy"] for found in told["results"]]) == ([3], ["static"])
    assert "commit" in told
    assert json.loads((folder / "results.json").read_text()) == told
    assert (folder / "README.md").read_text() == page(told)
