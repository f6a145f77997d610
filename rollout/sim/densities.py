"""The densities of sensors over a field: which share of the candidate places at a point is kept.

A density is drawn from a farm's random stream, so it is as much a function of the farm's seed as the places are.
All but "irregular" are measured in metres and sized by how much room the sensors need at their spacing.
"""

import math
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from common.config import WorldConfig
from common.seeds import stream

Array = NDArray[np.float64]
Density = Callable[[Array], Array]
"""Takes candidates [K, 2] as shares of the field's sides; returns the share of each to keep [K], 0..1 or above."""

DENSITY_FLOOR: Final = 0.15
"""Least acceptance of a candidate place on an irregular farm; 1 in the densest parts."""
PACKING: Final = 0.697
"""Sensors per square of the spacing when no more fit at random: disks of that diameter cover 0.547 of the area."""
PARKING: Final = 0.7476
"""The same along a line: Renyi's parking constant."""
CHOICES: Final = 8
"""Places that are drawn for an island's middle; the one farthest from the other islands is taken."""
ISLAND_FLOOR: Final = 0.004
"""Acceptance between the islands of a clustered farm: a few sensors stand alone."""
ROW_WIDTH: Final = 0.06
"""Sensors of a banded farm stand at most this share of the rows' distance from the middle of a row."""
PARCELS: Final = (9, 16)
"""Parcels of a patchy farm: least, and one more than most."""
EMPTY_SHARE: Final = (0.35, 0.6)
"""Share of a patchy farm that holds no sensor, as far as the spacing leaves room for that."""


def density_of(world: WorldConfig, seed: int) -> str:
    """Return the density of a farm: the configured one, and for "mixed" the one that the seed draws."""
    if world.density != "mixed":
        return world.density
    names = list(_DENSITIES)
    return names[int(stream(seed, "layout", "density").integers(len(names)))]


def make_density(kind: str, world: WorldConfig, random: np.random.Generator) -> Density:
    """Draw a density of a kind ("mixed" is none) from a farm's stream."""
    return _DENSITIES[kind](world, random)


def needed_share(world: WorldConfig) -> float:
    """Return the share of the field that the sensors fill when they stand as close as random sampling allows."""
    return world.sensors * world.sensor_spacing**2 / (PACKING * world.field_x * world.field_y)


def _irregular(world: WorldConfig, random: np.random.Generator) -> Density:
    """Three to seven hills over a floor."""
    hills = int(random.integers(3, 8))
    centre = random.uniform(0.0, 1.0, (hills, 2))
    width = random.uniform(0.08, 0.25, hills)
    height = random.uniform(0.3, 1.0, hills)

    def density(candidate: Array) -> Array:
        distance = np.linalg.norm(candidate[:, None] - centre, axis=2)
        share: Array = DENSITY_FLOOR + (height * np.exp(-0.5 * (distance / width) ** 2)).sum(axis=1)
        return share

    return density


def _uniform(world: WorldConfig, random: np.random.Generator) -> Density:
    """Alike everywhere."""
    return lambda candidate: np.ones(len(candidate))


def _clustered(world: WorldConfig, random: np.random.Generator) -> Density:
    """Four to eight islands of unlike size with hardly anything between; together they have the room that is needed."""
    size = np.array([world.field_x, world.field_y])
    islands = int(random.integers(4, 9))
    centre = _spread(random.uniform(0.08, 0.92, (islands, CHOICES, 2)) * size)
    share = random.dirichlet(np.full(islands, 6.0))
    room = max(0.06, 1.25 * needed_share(world)) * size.prod()
    radius = np.sqrt(share * room / math.pi)

    def density(candidate: Array) -> Array:
        distance = np.linalg.norm((candidate * size)[:, None] - centre, axis=2)
        hill: Array = np.exp(-0.5 * (1.4 * distance / radius) ** 2).max(axis=1)
        return np.maximum(hill, ISLAND_FLOOR)

    return density


def _banded(world: WorldConfig, random: np.random.Generator) -> Density:
    """Crop rows of one direction and distance, which is drawn so that the rows hold the sensors."""
    size = np.array([world.field_x, world.field_y])
    angle = random.uniform(0.0, math.pi)
    across = np.array([-math.sin(angle), math.cos(angle)])
    room = PARKING * size.prod() / max(world.sensors * world.sensor_spacing, 1e-9)
    pitch = random.uniform(0.7, 0.9) * min(room, size.min() / 5.0)
    offset = random.uniform(0.0, 1.0)

    def density(candidate: Array) -> Array:
        row = (candidate * size) @ across / pitch + offset
        return np.asarray(np.abs(row - np.rint(row)) < ROW_WIDTH, np.float64)

    return density


def _spread(choices: Array) -> Array:
    """Return one of the choices [K, C, 2] for each of K points, one after another the farthest from those before."""
    points = choices[:1, 0]
    for choice in choices[1:]:
        distance = np.linalg.norm(choice[:, None] - points, axis=2).min(axis=1)
        points = np.concatenate([points, choice[[distance.argmax()]]])
    return points


def _patchy(world: WorldConfig, random: np.random.Generator) -> Density:
    """Parcels around random centres, some of them without any sensor and the others alike."""
    size = np.array([world.field_x, world.field_y])
    centre = random.uniform(0.0, 1.0, (int(random.integers(*PARCELS)), 2)) * size
    wanted = min(random.uniform(*EMPTY_SHARE), 1.0 - needed_share(world) / 0.85)

    def parcel(candidate: Array) -> NDArray[np.intp]:
        nearest: NDArray[np.intp] = np.linalg.norm((candidate * size)[:, None] - centre, axis=2).argmin(axis=1)
        return nearest

    raster = (np.stack(np.meshgrid(np.arange(48), np.arange(48)), axis=-1).reshape(-1, 2) + 0.5) / 48
    area = np.bincount(parcel(raster), minlength=len(centre)) / len(raster)
    order = random.permutation(len(centre))
    planted = np.ones(len(centre))
    for number in order:
        if area[planted == 0.0].sum() + area[number] <= max(wanted, 0.0):
            planted[number] = 0.0
    return lambda candidate: planted[parcel(candidate)]


_DENSITIES: Final[dict[str, Callable[[WorldConfig, np.random.Generator], Density]]] = {
    "irregular": _irregular,
    "uniform": _uniform,
    "clustered": _clustered,
    "banded": _banded,
    "patchy": _patchy,
}
