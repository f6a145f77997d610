"""Where the charging stations are."""

import math

import numpy as np

from eia_sec.common.config import FarmConfig
from eia_sec.rollout.sim.boxes import Array


def station_places(config: FarmConfig) -> Array:
    """Return the places of the stations, [K, 2] m: in columns of nearly equal numbers, evenly over the field."""
    world, count = config.world, config.battery.stations
    columns = math.ceil(math.sqrt(count))
    borders = [count * k // columns for k in range(columns + 1)]
    places = []
    for column in range(columns):
        rows = borders[column + 1] - borders[column]
        x = (column + 0.5) / columns * world.field_x
        places += [(x, (row + 0.5) / rows * world.field_y) for row in range(rows)]
    return np.array(places)
