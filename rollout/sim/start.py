"""How an episode starts: where UAVs are, what counters hold, and the key that decides which packets arrive."""

import math
from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import WorldConfig
from eia_sec.common.config.farm.polygons import inside_any
from eia_sec.common.seeds import derive, stream

PLACES: Final = 32
"""Start positions that are drawn at a time."""
TRIES: Final = 200
"""Random positions to try for a UAV before the least distance shrinks by a tenth."""


def packet_key(farm_seed: int, episode_seed: int) -> int:
    """Return the episode's 63-bit packet key. With step and sensor it decides whether a packet arrives."""
    return derive(farm_seed, episode_seed, "packets")


def start_positions(
    world: WorldConfig, farm_seed: int, episode_seed: int, zones: tuple[NDArray[np.float64], ...] = ()
) -> NDArray[np.float64]:
    """Return the start positions of the UAVs, [n, 2] m: uniform, and at least d_safety apart within a plane.

    Places in no-fly zones, [C, 2] m each, are drawn again.
    If a plane is too crowded for that, the distance shrinks by a tenth until a position is found.
    """
    places: list[tuple[float, float]] = []
    drawn = _places_in_the_open(stream(farm_seed, episode_seed, "start"), world, zones)
    for count in (world.communication_uavs, world.monitoring_uavs, world.collection_uavs):
        plane: list[tuple[float, float]] = []
        apart, tries = world.safety_distance, 0
        while len(plane) < count:
            x, y = next(drawn)
            if all(math.sqrt((x - a) * (x - a) + (y - b) * (y - b)) >= apart for a, b in plane):
                plane.append((x, y))
                tries = 0
                continue
            tries += 1
            if tries % TRIES == 0:
                apart *= 0.9
        places += plane
    return np.array(places)


def _places_in_the_open(
    random: np.random.Generator, world: WorldConfig, zones: tuple[NDArray[np.float64], ...]
) -> Iterator[list[float]]:
    """Yield places [x, y] on the field, m, none of them in a zone."""
    while True:
        # Whether zones hold many places costs about as much as whether they hold one.
        places = random.random((PLACES, 2)) * (world.field_x, world.field_y)
        yield from places[~inside_any(places, zones)].tolist()


def start_levels(
    world: WorldConfig, farm_seed: int, episode_seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return AoI [S] and VDF [n_px, n_py] at the start: all 0, or uniform over 0..max."""
    age, level = np.zeros(world.sensors), np.zeros((world.plots_x, world.plots_y))
    if world.start_levels == "random":
        random = stream(farm_seed, episode_seed, "levels")
        age += random.integers(0, world.aoi_max, world.sensors, endpoint=True)
        level += random.integers(0, world.vdf_max, level.shape, endpoint=True)
    return age, level
