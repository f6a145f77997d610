"""Every UAV flies to the target with the best value / (distance + c)."""

from typing import Final

import numpy as np

from common.config import FarmConfig, WorldConfig
from common.team import Float32
from rollout.farms import FarmBatch
from rollout.heuristics.steering import Array, keep_apart, relay_targets, towards

OFFSET: Final = 10.0
"""c, m: the distance at which a target scores half of what it would score from right above. Between 2 and 80 m the mean
reward on farms 2000 to 2019 varies by 1 %; 10 m did best. Adding up the AoI around a sensor did not raise it."""
SEPARATION: Final = 40.0
"""Targets of two UAVs of a type are at least this far apart, m, so that none is shared and paths stay apart."""


def choose_targets(position: Array, target: Array, value: Array, offset: float, separation: float) -> Array:
    """Give each UAV in turn the best target that lies apart from those already given.

    Args:
        position: UAVs of one type, [E, n, 2] m.
        target: candidate places, [E, K, 2] m.
        value: what a visit is worth, [E, K]; nobody flies to a target worth 0.
        offset: c, m.
        separation: least distance between two given targets, m.

    Returns:
        [E, n, 2] m: each UAV's target, or its own place when nothing is worth a flight.
    """
    free = value > 0
    rows = np.arange(len(position))
    chosen = position.copy()
    for uav in range(position.shape[1]):
        distance = np.linalg.norm(target - position[:, None, uav], axis=2)
        score = np.where(free, value / (distance + offset), 0.0)
        best = score.argmax(axis=1)
        place = target[rows, best]
        worth = score[rows, best] > 0
        chosen[worth, uav] = place[worth]
        taken = np.linalg.norm(target - place[:, None], axis=2) < separation
        free &= ~(taken & worth[:, None])
    return chosen


def plot_centres(world: WorldConfig) -> Array:
    """Return the centres of all plots in the order of a flattened VDF map, [n_px * n_py, 2] m."""
    x = (np.arange(world.plots_x) + 0.5) * world.field_x / world.plots_x
    y = (np.arange(world.plots_y) + 0.5) * world.field_y / world.plots_y
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)


class GreedyPolicy:
    """Monitoring UAVs value a plot by its VDF, data collection UAVs a sensor by its AoI.

    Args:
        config: the farm.
    """

    def __init__(self, config: FarmConfig) -> None:
        self._world = config.world
        self._plots = plot_centres(config.world)
        self._sensors: dict[int, Array] = {}

    def reset(self, farms: FarmBatch, index: int) -> None:
        """Look up where one environment's sensors are."""
        self._sensors[index] = farms.layout(index).sensor_xy

    def act(self, farms: FarmBatch) -> Float32:
        """Return the actions [E, A] of this step."""
        world, count = self._world, len(farms.position)
        first = world.communication_uavs
        second = first + world.monitoring_uavs
        groups = slice(0, first), slice(first, second), slice(second, world.uavs)
        relays, monitors, collectors = (farms.position[:, agents] for agents in groups)
        plots = np.broadcast_to(self._plots, (count, *self._plots.shape))
        sensors = np.stack([self._sensors[index] for index in range(count)])
        targets = (
            relay_targets(farms),
            choose_targets(monitors, plots, farms.vdf.reshape(count, -1), OFFSET, SEPARATION),
            choose_targets(collectors, sensors, farms.aoi, OFFSET, SEPARATION),
        )
        parts = [
            keep_apart(position, towards(position, target, world), world)
            for position, target in zip((relays, monitors, collectors), targets, strict=True)
        ]
        return np.concatenate(parts, axis=1).reshape(count, -1).astype(np.float32)
