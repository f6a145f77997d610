"""The UAVs of a type divide the field. Each sweeps its part lane by lane, returns to its start and repeats.

Source: boustrophedon coverage (Choset and Pignon 1998) over a partition of the field.
"""

from typing import Final

import numpy as np

from eia_sec.common.config import WorldConfig
from eia_sec.rollout.heuristics.composite import COLLECTORS, MONITORS, FarmState, GroupPolicy
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
    """Return monitors that weave along lanes of LANE_PLOTS plots."""
    return TourFollower(sweep_routes(state.config), MONITORS, state)


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
