"""The bound that no policy exceeds: against counting by hand, and against policies that fly."""

from dataclasses import replace

import pytest

from eia_sec.common.config import FarmConfig, WorldConfig
from eia_sec.common.errors import ConfigError
from eia_sec.rollout.evaluation import evaluate
from eia_sec.rollout.policies import policy_of
from research.experiments.bound import bounds, images_one_plot, paid_plots, paid_sensors, upper_bound

WORLD = WorldConfig(
    communication_uavs=1,
    monitoring_uavs=2,
    collection_uavs=1,
    field_x=100.0,
    field_y=100.0,
    sensors=30,
    sensor_spacing=5.0,
    plots_x=5,
    plots_y=5,
    steps=120,
)


def counted(plots: int, monitors: int, steps: int, cycle: int) -> int:
    """Return the same step by step: from the end backwards, each step gives `monitors` plots their last visit."""
    paid = 0
    for step in range(steps, 0, -1):
        for _ in range(min(monitors, plots)):
            plots -= 1
            paid += len([rise for rise in range(1, step) if rise % cycle == 0])
    return paid


@pytest.mark.parametrize("monitors", [1, 2, 7])
@pytest.mark.parametrize("steps", [20, 61, 120])
def test_plots_are_paid_as_counted_by_hand(monitors, steps):
    """Last visits as late as possible, each paid what rose before it."""
    farm = FarmConfig(world=replace(WORLD, monitoring_uavs=monitors, communication_uavs=2, steps=steps))
    assert paid_plots(farm) == counted(25, monitors, steps, 30)


def test_sensors_are_paid_every_rise_before_the_last_step():
    """Ten sensors of each cycle of 40, 50 and 60 steps rise 2, 2 and 1 times before step 120."""
    assert paid_sensors(FarmConfig(world=WORLD), 3) == 10 * (2 + 2 + 1)


@pytest.mark.parametrize("policy", ["lawnmower", "greedy", "static"])
def test_no_policy_exceeds_it(policy):
    """Type by type, on farms where it is counted for the very episodes that are flown."""
    farm = FarmConfig(world=WORLD)
    flown = evaluate(farm, policy_of(policy, farm), range(5), 1, name=policy).to_dict()
    for row in flown["per_farm"]:
        bound = upper_bound(farm, row["farm"])
        assert all(row[letter] <= bound[letter] for letter in "cmd"), row
    assert flown["reward"]["mean"] <= bounds(farm, list(range(5)))["mean"]


def test_farms_without_a_bound_are_refused():
    """Random starts, and cameras that image several plots at once."""
    with pytest.raises(ConfigError, match="start at 0"):
        paid_plots(FarmConfig(world=replace(WORLD, start_levels="random")))
    wide = FarmConfig(world=replace(WORLD, plots_x=50, plots_y=50))
    assert not images_one_plot(wide)
    with pytest.raises(ConfigError, match="several plots"):
        paid_plots(wide)
