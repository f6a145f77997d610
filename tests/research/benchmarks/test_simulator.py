"""The simulator's benchmark: what is switched on, and the page that says what it costs."""

from dataclasses import replace

import numpy as np
import pytest

from research.benchmarks.simulator import ENDLESS, FARM, FIELD, flights, switched


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
