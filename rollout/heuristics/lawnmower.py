"""The UAVs of a type divide the field. Each sweeps its part lane by lane, returns to its start and repeats.

Source: boustrophedon coverage (Choset and Pignon 1998) over a partition of the field.
"""

from typing import Final

import numpy as np

from common.config import FarmConfig, WorldConfig
from rollout.heuristics.composite import COLLECTORS, MONITORS, FarmState, GroupPolicy
from rollout.heuristics.sites import plot_boxes
from rollout.heuristics.steering import Array, aim, steps_to
from rollout.heuristics.tour_follower import TourFollower

LANE_PLOTS: Final = 2
"""Plots side by side in a monitor's lane. A step is half a plot long, and anywhere near a plot's middle is close enough
to image it. So a UAV that weaves between two columns images a plot every step; over one column, every second step."""
LANE: Final = 50.0
"""Widest lane of a collector, m."""
INSET: Final = 33.0
"""A collector turns at this distance from the border of its area, m."""
ARRIVED: Final = 0.5
"""A collector has reached its turning point if it is within this distance along each axis, m."""

Block = tuple[int, int, int, int]
"""First column, end column, first row and end row of a part of the field; ends are exclusive."""


def monitors(state: FarmState) -> GroupPolicy:
    """Return monitors that weave along lanes of LANE_PLOTS plots."""
    return TourFollower(monitoring_routes(state.config), MONITORS, state)


def collectors(state: FarmState) -> GroupPolicy:
    """Return collectors that fly along lanes at most LANE wide."""
    return TourFollower(collection_routes(state.config.world), COLLECTORS, state)


def monitoring_routes(config: FarmConfig) -> list[Array]:
    """Return the plot boxes of each monitor's part in sweep order, [2, L, 2] m each."""
    world, boxes = config.world, plot_boxes(config)
    divisions = [
        [boxes[:, woven(block, world.plots_y)] for block in blocks]
        for blocks in divided(world.monitoring_uavs, world.plots_x, world.plots_y)
    ]
    return shortest(divisions, world)


def collection_routes(world: WorldConfig) -> list[Array]:
    """Return the boxes around the turning points of each collector's lanes, [2, L, 2] m each."""
    size = np.array([world.field_x, world.field_y])
    columns, rows = (max(1, int(np.ceil(length / LANE))) for length in size)
    divisions = [
        [_lanes(block, size / (columns, rows)) for block in blocks]
        for blocks in divided(world.collection_uavs, columns, rows)
    ]
    return shortest(divisions, world)


def divided(uavs: int, columns: int, rows: int) -> list[list[Block]]:
    """Return ways to divide columns x rows cells among UAVs: 1, 2, ... strips of columns, each cut across.

    If a strip has fewer rows than UAVs, some UAVs share a row.
    """
    ways = []
    for strips in range(1, min(uavs, columns) + 1):
        blocks = []
        for strip in range(strips):
            sharing = uavs // strips + (strip < uavs % strips)
            for part in range(sharing):
                low = part * rows // sharing
                high = max(low + 1, (part + 1) * rows // sharing)
                blocks.append((strip * columns // strips, (strip + 1) * columns // strips, low, high))
        ways.append(blocks)
    return ways


def shortest(divisions: list[list[Array]], world: WorldConfig) -> list[Array]:
    """Return the division whose longest closed route takes the fewest steps."""
    return min(divisions, key=lambda routes: max(round_steps(route, world) for route in routes))


def round_steps(route: Array, world: WorldConfig) -> int:
    """Return the steps of one lap through the boxes [2, L, 2] of a closed route."""
    length = route.shape[1]
    position, steps = route[:, 0].mean(axis=0), 0
    for at in range(1, length + 1):
        box, after = route[:, at % length], route[:, (at + 1) % length]
        steps += int(steps_to(position, box, world))
        position = aim(position, box, after, world)
    return steps


def woven(block: Block, rows: int) -> list[int]:
    """Return the plots of a block as row-major indices, in the order of a sweep back and forth between its columns.

    A lane ends on the side of the next lane.
    """
    first, last, low, high = block
    plots: list[int] = []
    for number, column in enumerate(range(first, last, LANE_PLOTS)):
        across = list(range(column, min(column + LANE_PLOTS, last)))
        along = range(low, high) if number % 2 == 0 else range(high - 1, low - 1, -1)
        for index, row in enumerate(along):
            forth = index % 2 == 0 or index == len(along) - 1
            plots += [x * rows + row for x in (across if forth else across[::-1])]
    return plots


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
