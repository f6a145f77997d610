"""Every UAV flies to the target with the best value / (distance + c)."""

from typing import Final

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from common.config import FarmConfig, WorldConfig
from common.team import Float32
from rollout.farms import FarmBatch
from rollout.heuristics.steering import Array, keep_apart, relay_targets, towards

OFFSET: Final = 20.0
"""c, m: the distance at which a target has half the score that it would have when very near."""
CLUSTER: Final = 20.0
"""A data collection UAV above a sensor also hears the sensors within this radius, m."""
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


def neighbourhood(place: Array, radius: float) -> csr_array:
    """Return the sparse 0/1 matrix [S, S] that tells which places [S, 2] lie within a radius; each is near itself."""
    pairs = cKDTree(place).query_pairs(radius, output_type="ndarray")
    itself = np.arange(len(place))
    row = np.concatenate([pairs[:, 0], pairs[:, 1], itself])
    column = np.concatenate([pairs[:, 1], pairs[:, 0], itself])
    return csr_array((np.ones(len(row)), (row, column)), shape=(len(place), len(place)))


class GreedyPolicy:
    """Monitoring UAVs value a plot by its VDF, data collection UAVs a sensor by the AoI around it.

    Args:
        config: the farm.
    """

    def __init__(self, config: FarmConfig) -> None:
        self._world = config.world
        self._plots = plot_centres(config.world)
        self._sensors: dict[int, Array] = {}
        self._near: dict[int, csr_array] = {}

    def reset(self, farms: FarmBatch, index: int) -> None:
        """Look up one environment's sensors and which of them lie together."""
        sensors = np.asarray(farms.layout(index).sensor_xy, np.float64)
        self._sensors[index] = sensors
        self._near[index] = neighbourhood(sensors, CLUSTER)

    def act(self, farms: FarmBatch) -> Float32:
        """Return the actions [E, A] of this step."""
        world, count = self._world, len(farms.position)
        first = world.communication_uavs
        second = first + world.monitoring_uavs
        groups = slice(0, first), slice(first, second), slice(second, world.uavs)
        relays, monitors, collectors = (farms.position[:, agents] for agents in groups)
        plots = np.broadcast_to(self._plots, (count, *self._plots.shape))
        sensors = np.stack([self._sensors[index] for index in range(count)])
        around = np.stack([self._near[index] @ farms.aoi[index] for index in range(count)])
        targets = (
            relay_targets(farms),
            choose_targets(monitors, plots, farms.vdf.reshape(count, -1), OFFSET, SEPARATION),
            choose_targets(collectors, sensors, around, OFFSET, SEPARATION),
        )
        parts = [
            keep_apart(position, towards(position, target, world), world)
            for position, target in zip((relays, monitors, collectors), targets, strict=True)
        ]
        return np.concatenate(parts, axis=1).reshape(count, -1).astype(np.float32)
