"""The field divided among the UAVs of a type; each sweeps its part to and fro."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import linear_sum_assignment

from common.config import FarmConfig, WorldConfig
from common.team import Float32
from rollout.farms import FarmBatch
from rollout.heuristics.steering import Array, keep_apart, relay_targets, towards

SWATH: Final = 50.0
"""Widest lane of a data collection UAV, m: from 18 m height a sensor 25 m aside is 31 m away and its PLR under 1 %."""
ARRIVED: Final = 0.5
"""A lane's end counts as reached within this distance, m."""


@dataclass(frozen=True)
class Area:
    """A part of the field, and how it is swept.

    Attributes:
        x: its borders along x, m.
        y: its borders along y, m.
        lanes: lanes along y, side by side.
        inset: distance of a lane's ends from the border, m.
    """

    x: tuple[float, float]
    y: tuple[float, float]
    lanes: int
    inset: float

    def path(self) -> Array:
        """Return the corners of one sweep, [2 * lanes, 2] m: up the first lane, down the second, and so on."""
        low, high = self.y[0] + self.inset, self.y[1] - self.inset
        width = (self.x[1] - self.x[0]) / self.lanes
        corners = []
        for lane in range(self.lanes):
            x = self.x[0] + (lane + 0.5) * width
            ends = [(x, low), (x, high)]
            corners += ends if lane % 2 == 0 else ends[::-1]
        return np.array(corners)


def monitoring_areas(world: WorldConfig) -> list[Area]:
    """Return one area of whole plots for each monitoring UAV; its lanes run through the plots' centres."""
    width, depth = world.field_x / world.plots_x, world.field_y / world.plots_y
    return [
        Area((a * width, b * width), (c * depth, d * depth), b - a, depth / 2)
        for a, b, c, d in _blocks(world.monitoring_uavs, world.plots_x, world.plots_y)
    ]


def collection_areas(world: WorldConfig) -> list[Area]:
    """Return one area for each data collection UAV, in lanes of at most SWATH."""
    columns = min(world.collection_uavs, max(1, int(world.field_x // SWATH)))
    rows = max(1, int(world.field_y // SWATH))
    width, depth = world.field_x / columns, world.field_y / rows
    lanes = int(np.ceil(width / SWATH))
    return [
        Area((a * width, b * width), (c * depth, d * depth), lanes * (b - a), min(SWATH, depth * (d - c)) / 2)
        for a, b, c, d in _blocks(world.collection_uavs, columns, rows)
    ]


def _blocks(uavs: int, columns: int, rows: int) -> list[tuple[int, int, int, int]]:
    """Divide columns x rows cells among UAVs: strips of columns, and strips cut across when there are too few.

    Returns:
        for each UAV its first and past-the-last column and row; with more UAVs than cells some share one.
    """
    strips = min(uavs, columns)
    borders = [strip * columns // strips for strip in range(strips + 1)]
    blocks = []
    for strip in range(strips):
        sharing = uavs // strips + (strip < uavs % strips)
        for part in range(sharing):
            low = part * rows // sharing
            high = max(low + 1, (part + 1) * rows // sharing)
            blocks.append((borders[strip], borders[strip + 1], low, high))
    return blocks


class _Sweep:
    """The UAVs of one type on their areas.

    Args:
        areas: one for each UAV.
        agents: where the type lies among all agents.
    """

    def __init__(self, areas: list[Area], agents: slice) -> None:
        tours = [_to_and_fro(area.path()) for area in areas]
        self.agents = agents
        self._length = np.array([len(tour) for tour in tours])
        self._corner = np.zeros((len(tours), self._length.max(), 2))
        for index, tour in enumerate(tours):
            self._corner[index, : len(tour)] = tour
        self._area: dict[int, Array] = {}
        self._next: dict[int, Array] = {}

    def reset(self, position: Array, index: int) -> None:
        """Give each UAV of one environment the area to whose start the fleet's way is shortest."""
        start = self._corner[:, 0]
        _, area = linear_sum_assignment(np.linalg.norm(position[:, None] - start[None], axis=2))
        self._area[index] = area
        self._next[index] = np.zeros(len(area), np.int64)

    def targets(self, position: Array) -> Array:
        """Return the corners [E, n_v, 2] that the UAVs at [E, n_v, 2] fly to now."""
        area = np.stack([self._area[index] for index in range(len(position))])
        corner = np.stack([self._next[index] for index in range(len(position))])
        arrived = np.linalg.norm(self._corner[area, corner] - position, axis=2) < ARRIVED
        corner = (corner + arrived) % self._length[area]
        self._next = dict(enumerate(corner))
        target: Array = self._corner[area, corner]
        return target


def _to_and_fro(path: Array) -> Array:
    """Return the closed tour along a path and back."""
    return np.concatenate([path, path[-2:0:-1]])


class LawnmowerPolicy:
    """Monitoring and data collection UAVs sweep at full speed; relays stay with those they serve.

    Args:
        config: the farm.
    """

    def __init__(self, config: FarmConfig) -> None:
        world = config.world
        first = world.communication_uavs
        second = first + world.monitoring_uavs
        self._world = world
        self._sweeps = (
            _Sweep(monitoring_areas(world), slice(first, second)),
            _Sweep(collection_areas(world), slice(second, world.uavs)),
        )

    def reset(self, farms: FarmBatch, index: int) -> None:
        """Divide one environment's field anew."""
        for sweep in self._sweeps:
            sweep.reset(farms.position[index, sweep.agents], index)

    def act(self, farms: FarmBatch) -> Float32:
        """Return the actions [E, A] of this step."""
        relays = farms.team.groups[0].count
        targets = [(slice(0, relays), relay_targets(farms))]
        targets += [(sweep.agents, sweep.targets(farms.position[:, sweep.agents])) for sweep in self._sweeps]
        parts = []
        for agents, target in targets:
            position = farms.position[:, agents]
            parts.append(keep_apart(position, towards(position, target, self._world), self._world))
        return np.concatenate(parts, axis=1).reshape(len(farms.position), -1).astype(np.float32)
