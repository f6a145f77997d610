"""Where the charging stations and the base station stand."""

import math
from typing import Final

import numpy as np

from eia_sec.common.config import FarmConfig
from eia_sec.rollout.sim.core.records import Array

MIDDLES: Final = {"north": (0.5, 1.0), "east": (1.0, 0.5), "south": (0.5, 0.0), "west": (0.0, 0.5)}
"""Middles of the field's edges as shares of its sides; x goes east and y north."""


def station_places(config: FarmConfig) -> Array:
    """Return the charging stations, [K, 2] m: in columns of nearly equal numbers, evenly over the field."""
    world, count = config.world, config.battery.stations
    columns = math.ceil(math.sqrt(count))
    borders = [count * k // columns for k in range(columns + 1)]
    places = []
    for column in range(columns):
        rows = borders[column + 1] - borders[column]
        x = (column + 0.5) / columns * world.field_x
        places += [(x, (row + 0.5) / rows * world.field_y) for row in range(rows)]
    return np.array(places)


def base_place(config: FarmConfig) -> Array:
    """Return where the base station stands, [2] m; (0, 0) if there is none."""
    share = MIDDLES.get(config.relay.base, (0.0, 0.0))
    return np.array(share) * (config.world.field_x, config.world.field_y)
