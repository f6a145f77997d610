"""The no-fly zones of a farm."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.farm.zones import LONGEST_SIDE
from eia_sec.common.seeds import stream
from eia_sec.rollout.sim.stations import station_places

Array = NDArray[np.float64]

SHORTEST_SIDE: Final = 30.0
"""Shortest side of a drawn zone, m."""
GAP: Final = 20.0
"""Least distance between the circles around two drawn zones, m, so that UAVs can pass between them."""
TRIES: Final = 200
"""Places to try for a zone before the gap is given up."""


def make_zones(config: FarmConfig, seed: int) -> tuple[Array, ...]:
    """Return the zones of a farm, [C, 2] m each: the given ones, then rectangles drawn from its seed.

    Where UAVs have batteries, the drawn ones leave the charging stations free, if there is room.
    """
    zones = [np.array(corners, np.float64) for corners in config.zones.polygons]
    random, size = stream(seed, "layout", "zones"), np.array([config.world.field_x, config.world.field_y])
    stations = [place[None] for place in station_places(config)] if config.battery.some else []
    for _ in range(config.zones.random):
        zones.append(_rectangle(random, size, [*zones, *stations]))
    for zone in zones:
        zone.setflags(write=False)
    return tuple(zones)


def _rectangle(random: np.random.Generator, size: Array, others: list[Array]) -> Array:
    """Return a rectangle in the field, apart from what else is there, [C, 2] m each, where there is room."""
    longest = min(LONGEST_SIDE, 0.6 * float(size.min()))
    sides = random.uniform(min(SHORTEST_SIDE, longest), longest, 2)
    turn = random.uniform(0.0, 0.5 * math.pi)
    along = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    shape = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]) * sides @ along
    room, radius = np.abs(shape).max(axis=0), 0.5 * math.hypot(*sides)
    room = np.minimum(room, 0.5 * size)
    for _ in range(TRIES):
        middle = room + random.random(2) * (size - 2.0 * room)
        if all(np.hypot(*(other - middle).T).min() >= radius + GAP for other in others):
            break
    zone: Array = middle + shape
    return zone
