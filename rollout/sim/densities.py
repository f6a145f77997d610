"""Sensor densities: the probability of keeping a candidate position at each point of the field.

A density is drawn from a farm's random stream, so the farm's seed determines it, just as it determines the positions.
All but "irregular" have sizes in metres, which follow from the room that the sensors need at their spacing.
"""

import math
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import WorldConfig
from eia_sec.common.seeds import stream

Array = NDArray[np.float64]
Density = Callable[[Array], Array]
"""Maps candidates [K, 2], as fractions of the field's sides, to acceptance probabilities [K]; above 1 counts as 1."""

DENSITY_FLOOR: Final = 0.15
"""Least acceptance on an irregular farm; it is 1 in the densest parts."""
PACKING: Final = 0.697
"""Sensors per squared spacing once random sampling can add no more. Disks of that diameter then cover 0.547."""
PARKING: Final = 0.7476
"""The same along a line: Renyi's parking constant."""
CHOICES: Final = 8
"""Candidates for the centre of an island; the one farthest from the other islands is taken."""
ISLAND_FLOOR: Final = 0.004
"""Acceptance between the islands of a clustered farm, so that a few sensors stand alone."""
ROW_WIDTH: Final = 0.06
"""Largest distance of a banded farm's sensors from the middle of their row, as a fraction of the row spacing."""
PARCELS: Final = (9, 16)
"""Range of the number of parcels on a patchy farm; the upper end is exclusive."""
EMPTY_SHARE: Final = (0.35, 0.6)
"""Range of the share of a patchy farm without sensors, where the spacing leaves room for it."""


def density_of(world: WorldConfig, seed: int) -> str:
    """Return a farm's density: the configured one, or for "mixed" one drawn by the seed."""
    if world.density != "mixed":
        return world.density
    names = list(_DENSITIES)
    return names[int(stream(seed, "layout", "density").integers(len(names)))]


def make_density(kind: str, world: WorldConfig, random: np.random.Generator) -> Density:
    """Draw a density of a kind from a farm's stream; "mixed" is not a kind."""
    return _DENSITIES[kind](world, random)


def needed_share(world: WorldConfig) -> float:
    """Return the share of the field that the sensors fill when packed as tightly as random sampling allows."""
    return world.sensors * world.sensor_spacing**2 / (PACKING * world.field_x * world.field_y)


def _irregular(world: WorldConfig, random: np.random.Generator) -> Density:
    """Make three to seven hills over a floor."""
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
    """Make the same density everywhere."""
    return lambda candidate: np.ones(len(candidate))


def _clustered(world: WorldConfig, random: np.random.Generator) -> Density:
    """Make four to eight islands of different sizes, nearly empty in between. Together they hold the sensors."""
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
    """Make parallel crop rows, spaced so that they hold the sensors."""
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
    """Pick one of the choices [K, C, 2] for each of K points in turn: the farthest from those already picked."""
    points = choices[:1, 0]
    for choice in choices[1:]:
        distance = np.linalg.norm(choice[:, None] - points, axis=2).min(axis=1)
        points = np.concatenate([points, choice[[distance.argmax()]]])
    return points


def _patchy(world: WorldConfig, random: np.random.Generator) -> Density:
    """Make parcels around random centres. Some hold no sensor; the others share one density."""
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
