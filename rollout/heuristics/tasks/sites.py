"""Where UAVs can work: the boxes from which a plot can be imaged, and the reach of a sensor's radio."""

import functools
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from eia_sec.common.config import FarmConfig, WorldConfig
from eia_sec.rollout.sim.boxes import Array, reach
from eia_sec.rollout.sim.core.camera import plot_quality
from eia_sec.rollout.sim.core.constants import constants
from eia_sec.rollout.sim.core.radio import delivery, received_power

Indices = NDArray[np.int64]

STOP_CHANCE: Final = 0.95
"""A stop covers the sensors whose packets arrive there with at least this probability."""
STOP_MARGIN: Final = 4.0
"""A UAV has reached a stop if it is within this distance along each axis, m."""
CHANCE_STEP: Final = 0.25
"""Spacing of the distances at which the radio link is tabulated, m."""


def images_succeed(config: FarmConfig, places: Array, plots: Indices) -> NDArray[np.bool_]:
    """Return whether a UAV over each place [P, 2] m takes a good image of its plot [P], a row-major index."""
    camera, rows = constants(config).camera, config.world.plots_y
    pairs = zip(places.tolist(), plots.tolist(), strict=True)
    quality = [plot_quality(camera, x, y, plot // rows, plot % rows) for (x, y), plot in pairs]
    return np.array(quality) >= camera.threshold


def packet_chances(config: FarmConfig, distance: Array) -> Array:
    """Return the probability that a packet arrives over horizontal distances [...], m, to the nearest CHANCE_STEP."""
    chances = _chance_table(config)
    index = np.minimum(np.rint(distance / CHANCE_STEP).astype(np.int64), len(chances) - 1)
    found: Array = chances[index]
    return found


def radio_reach(config: FarmConfig, chance: float) -> float:
    """Return the horizontal distance within which a packet arrives with at least this probability, m."""
    return CHANCE_STEP * max(0, int(np.argmin(_chance_table(config) >= chance)) - 1)


def radio_range(config: FarmConfig, chance: float) -> float:
    """Return a horizontal distance beyond which no packet arrives with more than this probability, m."""
    return CHANCE_STEP * (1 + int(np.flatnonzero(_chance_table(config) > chance).max(initial=-1)))


@functools.lru_cache(maxsize=8)
def _chance_table(config: FarmConfig) -> Array:
    """Return the probability at each multiple of CHANCE_STEP, with a final 0 beyond the field's diagonal."""
    radio, height = constants(config).radio, config.world.height_collection
    distances = np.arange(0.0, np.hypot(config.world.field_x, config.world.field_y), CHANCE_STEP)
    squares = distances * distances + height * height
    return np.array([*(delivery(radio, received_power(radio, square)) for square in squares), 0.0])


def steps_between(places: Array, others: Array, world: WorldConfig) -> Array:
    """Return the flight times from each place [a, 2] to each other place [b, 2], in unrounded steps: [a, b]."""
    steps: Array = (np.abs(places[:, None] - others[None]) / reach(world)).max(axis=-1)
    return steps


def pairs_within(places: Array, others: Array, far: float) -> tuple[Indices, Indices, Array]:
    """Return the pairs of places [a, 2] m and others [b, 2] m within `far` m of each other, ordered by index.

    Only these pairs take memory, so the field may be of any size.

    Returns:
        Indices of the places [P], indices of the others [P], and the distances [P], m.
    """
    found = cKDTree(places).sparse_distance_matrix(cKDTree(others), far, output_type="ndarray")
    found = found[np.lexsort((found["j"], found["i"]))]
    return found["i"].astype(np.int64), found["j"].astype(np.int64), found["v"]


def sensor_stops(config: FarmConfig, xy: Array) -> Array:
    """Return boxes around places that together hear all sensors [S, 2] well: [2, L, 2] m.

    The places are chosen greedily from an even lattice: next comes the one near most of the remaining sensors.
    """
    size = np.array([config.world.field_x, config.world.field_y])
    x, y = (np.arange(step / 2.0, width, step) for step, width in zip(reach(config.world), size, strict=True))
    places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    place, sensor, _ = pairs_within(places, xy, max(radio_reach(config, STOP_CHANCE), reach(config.world).max()))
    covers = csr_array((np.ones(len(place), np.int64), (place, sensor)), shape=(len(places), len(xy)))
    left = np.zeros(len(xy), np.int64)
    left[sensor] = 1
    chosen: list[int] = []
    while left.any():
        best = int((covers @ left).argmax())
        left[covers.indices[covers.indptr[best] : covers.indptr[best + 1]]] = 0
        chosen.append(best)
    stops = places[chosen] if chosen else size[None] / 2.0
    return np.clip(np.stack([stops - STOP_MARGIN, stops + STOP_MARGIN]), 0.0, size)
