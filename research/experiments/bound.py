"""What no policy can exceed: a bound of the reward per agent, from supply, cameras, energy and where relays start.

    python -m research.experiments.bound [--farms 1000:1100]

It leaves out everything that is hard to bound: the range of the radios, lost packets, the ways between sensors, the
ways of monitors from plot to plot, and that served counters cannot rise. So it cannot be reached.

- Counters start at 0 and rise at multiples of their cycle (W18), and a visit in step t pays what had risen by step
  t - 1. All of a type together cannot be paid more than all rises before the last step.
- A monitor images at most one plot in a step where no plot is imaged from over its neighbour, so the last
  visits of all plots take at least n_px n_py / n_m steps, and what rises after a plot's last visit is never paid.
- A step pays at most one motivation bonus; before the first rise it costs the penalty for an idle step instead.
- A step's energy is at least that of the cheapest speed, and a relay cannot bring D_c below 0.
"""

import argparse
import json
import sys
from typing import Any, Final

import numpy as np

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.presets import preset
from eia_sec.common.errors import ConfigError
from eia_sec.deploy.reports.provenance import provenance
from eia_sec.rollout.evaluation import episode_seed
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.core.camera import plot_quality
from eia_sec.rollout.sim.core.constants import constants
from eia_sec.rollout.sim.core.motion import flight_power
from eia_sec.rollout.sim.layout import make_layout
from eia_sec.rollout.sim.sweep_routes import plot_half
from research.experiments.reporting import farm_range

SPEEDS: Final = 2001
"""Speeds among which the cheapest is sought."""
PLACES: Final = 401
"""Places beside a plot, on each side, from which it is tried to image it."""


def images_one_plot(config: FarmConfig) -> bool:
    """Return whether a camera images no plot but the one that it is over, tried on a fine grid around a plot."""
    camera, half = constants(config).camera, plot_half(config.world)
    beside = np.linspace(1.0, 3.0, PLACES)
    places = [half + half * (along * np.array(axis)) for axis in ((1.0, 0.0), (0.0, 1.0)) for along in beside]
    return all(plot_quality(camera, float(x), float(y), 0, 0) < camera.threshold for x, y in places)


def paid_plots(config: FarmConfig) -> float:
    """Return the most VDF that all monitors together can be paid for.

    Raises:
        ConfigError: cameras see several plots at once, or starts are random, where this bound does not hold.
    """
    world = config.world
    if not images_one_plot(config):
        raise ConfigError("a camera images several plots at once; the bound holds for one plot a step.")
    if world.start_levels != "zero":
        raise ConfigError("the bound holds for counters that start at 0.")
    cycle = round(world.vdf_cycle / world.step_seconds)
    last = world.steps - np.arange(world.plots_x * world.plots_y) // world.monitoring_uavs
    return float(np.maximum(0, (last - 1) // cycle).sum())


def paid_sensors(config: FarmConfig, farm: int) -> float:
    """Return the most AoI that all data collection UAVs together can be paid for on a farm."""
    return float(((config.world.steps - 1) // make_layout(config, farm).sensor_cycle_steps).sum())


def upper_bound(config: FarmConfig, farm: int) -> dict[str, float]:
    """Return the bound of the episode reward of one UAV of each type, by the type's letter, on a farm's first episode.

    Raises:
        ConfigError: the farm is one for which it does not hold.
    """
    world, pay = config.world, config.reward
    known = constants(config)
    speeds = np.linspace(0.0, float(np.hypot(world.speed_x_max, world.speed_y_max)), SPEEDS)
    least = min(flight_power(known.flight, float(speed)) for speed in speeds)
    spent = [pay.energy * (least + extra) * world.steps * world.step_seconds for extra in known.fleet.payloads]
    farms = FarmBatch(config, 1)
    farms.reset(0, farm, episode_seed(farm, 0))
    plots, sensors = paid_plots(config), paid_sensors(config, farm)
    idle = [round(cycle / world.step_seconds) for cycle in (world.vdf_cycle, min(world.sensor_cycles))]
    busy = [world.steps - steps for steps in idle]
    return {
        "c": pay.positioning * float(farms.service[0].mean()) - spent[0],
        "m": pay.monitoring * plots / world.monitoring_uavs
        + pay.monitoring_motivation * busy[0]
        - pay.monitoring_idle * idle[0]
        - spent[1],
        "d": pay.collection * sensors / world.collection_uavs
        + pay.collection_motivation * busy[1]
        - pay.collection_idle * idle[1]
        - spent[2],
    }


def bounds(config: FarmConfig, farms: list[int]) -> dict[str, Any]:
    """Return the mean bound over farms: by type, and per agent."""
    rows = [upper_bound(config, farm) for farm in farms]
    means = {letter: float(np.mean([row[letter] for row in rows])) for letter in rows[0]}
    world = config.world
    counts = (world.communication_uavs, world.monitoring_uavs, world.collection_uavs)
    return {"mean": float(np.average(list(means.values()), weights=counts)), **means}


def main() -> None:
    """Print the bound."""
    parser = argparse.ArgumentParser(
        prog="python -m research.experiments.bound", description=(__doc__ or "").partition("\n")[0]
    )
    parser.add_argument("--farms", type=farm_range, default="1000:1100", help="farm seeds A:B, from A to B - 1")
    found = {
        **bounds(preset("study").farm, list(parser.parse_args().farms)),
        **provenance("research.experiments.bound"),
    }
    sys.stdout.write(json.dumps(found) + "\n")


if __name__ == "__main__":
    main()
