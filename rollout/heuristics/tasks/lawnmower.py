"""The UAVs of a type divide the field. Each sweeps its part lane by lane, returns to its start and repeats.

Source: boustrophedon coverage (Choset and Pignon 1998) over a partition of the field.
"""

import functools
from typing import Final

import numpy as np

from eia_sec.common.config import FarmConfig, WorldConfig
from eia_sec.rollout.heuristics.composite import COLLECTORS, MONITORS, FarmState, GroupPolicy
from eia_sec.rollout.heuristics.inertia import Inertia
from eia_sec.rollout.heuristics.tasks.tour_follower import TourFollower
from eia_sec.rollout.sim.boxes import Array
from eia_sec.rollout.sim.sweep_routes import Block, divided, plot_boxes, shortest, sweep_routes

LANE: Final = 50.0
"""Widest lane of a collector, m."""
INSET: Final = 33.0
"""A collector turns at this distance from the border of its area, m."""
TURN: Final = 8.0
"""With inertia, a collector begins to turn so far before or behind this place, m."""
ARRIVED: Final = 0.5
"""A UAV has reached its turning point or lane if it is within this distance along each axis, m."""


def monitors(state: FarmState) -> GroupPolicy:
    """Return monitors that weave along lanes of LANE_PLOTS plots, or with inertia fly straight over each column."""
    if state.config.dynamics.inertial:
        return TourFollower(straight_routes(state.config), MONITORS, state, through=True)
    return TourFollower(sweep_routes(state.config), MONITORS, state)


def collectors(state: FarmState) -> GroupPolicy:
    """Return collectors that fly along lanes at most LANE wide."""
    through, routes = state.config.dynamics.inertial, collection_routes(state.config.world)
    if through:
        routes = [route + np.array([[[0.0, -TURN]], [[0.0, TURN]]]) for route in routes]
    return TourFollower(routes, COLLECTORS, state, through=through)


def collection_routes(world: WorldConfig) -> list[Array]:
    """Return the boxes around the turning points of each collector's lanes, [2, L, 2] m each."""
    size = np.array([world.field_x, world.field_y])
    columns, rows = (max(1, int(np.ceil(length / LANE))) for length in size)
    divisions = [
        [_lanes(block, size / (columns, rows)) for block in blocks]
        for blocks in divided(world.collection_uavs, columns, rows)
    ]
    return shortest(divisions, world)


@functools.lru_cache(maxsize=64)
def straight_routes(config: FarmConfig) -> list[Array]:
    """Return the boxes around the ends of each monitor's lanes, [2, L, 2] m each; a lane lies over each column.

    A lane's box is where it ends; the next lane begins where the UAV has turned. The field is divided so that the
    longest lap takes the least time.
    """
    world, boxes = config.world, plot_boxes(config)
    divisions = [
        [_columns(block, boxes, world.plots_y) for block in blocks]
        for blocks in divided(world.monitoring_uavs, world.plots_x, world.plots_y)
    ]
    return min(divisions, key=lambda routes: max(lap_seconds(route, config) / _laps(route) for route in routes))


def _columns(block: Block, boxes: Array, rows: int) -> Array:
    """Return boxes at the ends of lanes over each column of a block: every second column, then back over the others.

    Lanes side by side would leave the way from the last to the first.
    """
    first, last, low, high = block
    columns = [*range(first, last, 2), *range(first + 1, last, 2)[::-1]]
    if len(columns) % 2:
        columns += columns  # a second lap, in which each lane is flown the other way
    ends = [(high - 1) if number % 2 == 0 else low for number in range(len(columns))]
    box = boxes[:, np.array(columns) * rows + np.array(ends)].copy()
    middle = box[..., 0].mean(axis=0)
    box[..., 0] = np.stack([middle - ARRIVED, middle + ARRIVED])
    return box


def _laps(route: Array) -> int:
    """Return the laps of a route; see `_columns`."""
    return int(route.shape[1]) // len(np.unique(route[0, :, 0]))


def lap_seconds(route: Array, config: FarmConfig) -> float:
    """Return the time of a lap of a monitor that stands at every box of a route [2, L, 2]."""
    place = route.mean(axis=0)
    inertia = Inertia(config, np.array([MONITORS]))
    return float(inertia.seconds_for(np.roll(place, -1, axis=0) - place).sum())


def _lanes(block: Block, cell: Array) -> Array:
    """Return boxes around the turning points of a block of cells of size [2] m. Each column is a lane."""
    first, last, low, high = block
    bottom, top = low * cell[1], high * cell[1]
    inset = min(INSET, (top - bottom) / 2.0)
    corners = []
    for number, column in enumerate(range(first, last)):
        x = (column + 0.5) * cell[0]
        ends = [(x, bottom + inset), (x, top - inset)]
        corners += ends if number % 2 == 0 else ends[::-1]
    place = np.array(corners)
    return np.stack([place - ARRIVED, place + ARRIVED])
