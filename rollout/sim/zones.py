"""No-fly zones: those of a farm's seed, and the geometry of polygons.

A zone is a closed polygon: its border belongs to it.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from common.config import FarmConfig
from common.config.farm.zones import LONGEST_SIDE
from common.seeds import stream

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

SHORTEST_SIDE: Final = 30.0
"""Shortest side of a drawn zone, m."""
GAP: Final = 20.0
"""Least distance between the circles around two drawn zones, m, so that UAVs can pass between them."""
TRIES: Final = 200
"""Places to try for a zone before the gap is given up."""


def make_zones(config: FarmConfig, seed: int) -> tuple[Array, ...]:
    """Return the zones of a farm, [C, 2] m each: the given ones, then rectangles drawn from its seed."""
    zones = [np.array(corners, np.float64) for corners in config.zones.polygons]
    random, size = stream(seed, "layout", "zones"), np.array([config.world.field_x, config.world.field_y])
    for _ in range(config.zones.random):
        zones.append(_rectangle(random, size, zones))
    for zone in zones:
        zone.setflags(write=False)
    return tuple(zones)


def _rectangle(random: np.random.Generator, size: Array, others: list[Array]) -> Array:
    """Return a rectangle in the field, apart from the others where there is room."""
    longest = min(LONGEST_SIDE, 0.6 * float(size.min()))
    sides = random.uniform(min(SHORTEST_SIDE, longest), longest, 2)
    turn = random.uniform(0.0, 0.5 * math.pi)
    along = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    shape = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]) * sides @ along
    room, radius = np.abs(shape).max(axis=0), 0.5 * math.hypot(*sides)
    room = np.minimum(room, 0.5 * size)
    middle = 0.5 * size
    for _ in range(TRIES):
        middle = room + random.random(2) * (size - 2.0 * room)
        if all(np.hypot(*(other - middle).T).min() >= radius + GAP for other in others):
            break
    zone: Array = middle + shape
    return zone


def inside(points: Array, zone: Array) -> Flags:
    """Return whether points [..., 2] lie in a zone, by the number of sides that a ray to the right crosses."""
    x, y = points[..., 0, None], points[..., 1, None]
    (ax, ay), (bx, by) = zone.T, np.roll(zone, -1, axis=0).T
    crosses = (ay > y) != (by > y)
    rise = np.where(ay == by, 1.0, by - ay)
    odd = (crosses & (x < ax + (y - ay) * (bx - ax) / rise)).sum(axis=-1) % 2 == 1
    within: Flags = odd | touches(points, points, zone)
    return within


def touches(start: Array, end: Array, zone: Array) -> Flags:
    """Return whether straight ways from `start` to `end`, [..., 2] m each, meet a zone's border."""
    a, b = start[..., None, :], end[..., None, :]
    c, d = zone, np.roll(zone, -1, axis=0)
    apart = (np.maximum(a, b) < np.minimum(c, d)) | (np.maximum(c, d) < np.minimum(a, b))
    across = (_turn(a, b, c) * _turn(a, b, d) <= 0.0) & (_turn(c, d, a) * _turn(c, d, b) <= 0.0)
    return np.asarray((across & ~apart.any(axis=-1)).any(axis=-1), np.bool_)


def _turn(a: Array, b: Array, c: Array) -> Array:
    """Return twice the signed area of triangles a, b, c."""
    area: Array = (b[..., 0] - a[..., 0]) * (c[..., 1] - a[..., 1]) - (b[..., 1] - a[..., 1]) * (c[..., 0] - a[..., 0])
    return area


def inside_any(points: Array, zones: tuple[Array, ...]) -> Flags:
    """Return whether points [..., 2] lie in any zone."""
    found = np.zeros(points.shape[:-1], np.bool_)
    for zone in zones:
        found |= inside(points, zone)
    return found


def refused(start: Array, end: Array, zones: tuple[Array, ...]) -> Flags:
    """Return whether moves from `start` to `end`, [..., 2] m each, end in a zone or cross one.

    A move that leads nowhere is never refused.
    """
    found = np.zeros(np.broadcast_shapes(start.shape, end.shape)[:-1], np.bool_)
    for zone in zones:
        found |= inside(end, zone) | touches(start, end, zone)
    stopped: Flags = found & (start != end).any(axis=-1)
    return stopped
