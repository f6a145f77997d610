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
from eia_sec.rollout.sim.sweep_routes import Block, divided, shortest, sweep_routes

LANE: Final = 50.0
"""Widest lane of a collector, m."""
INSET: Final = 33.0
"""A collector turns at this distance from the border of its area, m."""
ARRIVED: Final = 0.5
"""A collector has reached its turning point if it is within this distance along each axis, m."""


def monitors(state: FarmState) -> GroupPolicy:
    """Return monitors that weave along lanes of LANE_PLOTS plots, or with inertia fly straight over each column."""
    routes = straight_routes(state.config) if state.config.dynamics.inertial else sweep_routes(state.config)
    return TourFollower(routes, MONITORS, state)


def collectors(state: FarmState) -> GroupPolicy:
    """Return collectors that fly along lanes at most LANE wide."""
    return TourFollower(collection_routes(state.config.world), COLLECTORS, state)


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
    """Return the boxes around the turning points of each monitor's lanes, [2, L, 2] m each, one over each column.

    The field is divided so that the longest lap takes the least time with all its turns.
    """
    world = config.world
    divisions = [
        [_columns(block, world) for block in blocks]
        for blocks in divided(world.monitoring_uavs, world.plots_x, world.plots_y)
    ]
    return min(divisions, key=lambda routes: max(lap_seconds(route, config) for route in routes))


def _columns(block: Block, world: WorldConfig) -> Array:
    """Return boxes around the middles of the first and the last plot of each column of a block."""
    first, last, low, high = block
    size = np.array([world.field_x / world.plots_x, world.field_y / world.plots_y])
    rows = [(low, high - 1), (high - 1, low)]
    ends = [(column, row) for number, column in enumerate(range(first, last)) for row in rows[number % 2]]
    place = (np.array(ends) + 0.5) * size
    return np.stack([place - ARRIVED, place + ARRIVED])


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
