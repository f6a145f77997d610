"""The simulator's benchmark: what is switched on, and the page that says what it costs."""

from dataclasses import replace

import numpy as np
import pytest

from research.benchmarks.simulator import ENDLESS, FARM, FIELD, flights, switched
from research.benchmarks.simulator_page import table, write

FOUND = {
    "machine": {"processor": "any", "cores": 2, "numba": "1"},
    "farm": {"uavs": 12, "sensors": 400, "plots": 400},
    "by_batch": {"32": {"env_steps_per_second_per_core": 125_000, "cpu_us": 8.0, "fastest_tenth_us": 6.0}},
    "single_step_us": 9.0,
    "reference_steps_per_second": 100.0,
    "reference_ratio": 1250.0,
    "threads": {"environments": 64, "wall_us": {"1": 8.0}, "same_results": True},
    "switches": {"environments": 32, "us_per_step": {"none": 8.0, "all": 16.0}},
}


def test_all_switches_are_those_of_the_preset_field():
    """The last farm is the preset's, but for control, further observations, autopilots and the size of batteries."""
    battery = replace(FIELD.battery, capacity=ENDLESS, failsafe=0.0)
    views = replace(FARM.observation, link=True, stress=True, charge=True, wind=True, zones=True)
    assert views != FARM.observation
    assert switched()["all"] == replace(FIELD, battery=battery, observation=views, control=FARM.control)


@pytest.mark.parametrize("name", switched())
def test_each_switch_changes_what_uavs_observe(name):
    """Observations are wider than without it, and numbers."""
    short = replace(FARM.world, steps=20)
    (plain, _), (last, _) = (
        list(flights(replace(farm, world=short), 2, 1, 20))[-1] for farm in (FARM, switched()[name])
    )
    assert (last.observation.shape == plain.observation.shape) == (name == "none")
    assert np.isfinite(last.observation).all()
    assert np.isfinite(last.reward).all()


def test_no_battery_runs_out():
    """Nobody is gone at the end of an episode, and everybody has used charge."""
    last, _ = list(flights(switched()["batteries"], 2, 1, FARM.world.steps))[-1]
    assert not last.gone.any()
    assert (last.charge < ENDLESS).all()


def test_the_page_shows_what_switches_cost(tmp_path):
    """As steps a second of a core, in the terminal and on the page."""
    assert "switched on: all" in table(FOUND)
    write(FOUND, tmp_path)
    assert "| all | 62,500 steps a second of one core (16.00 us a step) |" in (tmp_path / "README.md").read_text()
