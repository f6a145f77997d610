"""Closed polygons: their form in a configuration, their checks, and their geometry. The border belongs to them."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.errors import ConfigError

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Polygon = tuple[tuple[float, ...], ...]
"""The corners (x, y), m, in order around it; the last is not the first again."""

MAX_CORNERS: Final = 32
"""Most corners of a polygon."""
FARTHEST: Final = 1e6
"""Largest coordinate of a corner, m."""


def check_polygon(name: str, corners: Polygon) -> None:
    """Refuse corners that are none, or too many, and a polygon that crosses itself.

    Args:
        name: the polygon's place in the configuration, for the error's sentence.
        corners: its corners.

    Raises:
        ConfigError: the polygon is none.
    """
    if not 3 <= len(corners) <= MAX_CORNERS:
        raise ConfigError(f"{name} has {len(corners)} corners, not 3 to {MAX_CORNERS}.")
    for corner in corners:
        if len(corner) != 2 or not all(-FARTHEST <= number <= FARTHEST for number in corner):
            raise ConfigError(f"{name} needs corners [x, y] in m, not {list(corner)[:4]}.")
    if _crosses_itself(corners):
        raise ConfigError(f"{name} crosses itself, or names a corner twice.")


def _crosses_itself(corners: Polygon) -> bool:
    """Return whether two sides of a polygon meet anywhere but in the corner that they share."""
    place, count = np.array(corners), len(corners)
    if len(set(corners)) < count:
        return True
    for a in range(count):
        for b in range(a + 1, count):
            first, second = (place[a], place[(a + 1) % count]), (place[b], place[(b + 1) % count])
            if b - a in (1, count - 1):
                shared, one, other = (second[0], first[0], second[1]) if b - a == 1 else (first[0], first[1], second[0])
                if turn(shared, one, other) == 0.0 and (one - shared) @ (other - shared) > 0.0:
                    return True
            elif meet(*first, *second):
                return True
    return False


def crosses_itself(ring: Array) -> bool:
    """Return whether two sides of a closed ring [n, 2], whose last position is the first, cross inside both.

    A surveyed ring may repeat positions and touch itself.
    """
    start, end = ring[:-1], ring[1:]
    for a, b, rest in zip(start, end, range(1, len(start) + 1), strict=True):
        c, d = start[rest:], end[rest:]
        if bool(((turn(a, b, c) * turn(a, b, d) < 0.0) & (turn(c, d, a) * turn(c, d, b) < 0.0)).any()):
            return True
    return False


def inside(points: Array, zone: Array) -> Flags:
    """Return whether points [..., 2] lie in a zone, by the number of sides that a ray to the right crosses."""
    x, y = points[..., 0, None], points[..., 1, None]
    (ax, ay), (bx, by) = zone.T, following(zone).T
    crosses = (ay > y) != (by > y)
    rise = np.where(ay == by, 1.0, by - ay)
    odd = (crosses & (x < ax + (y - ay) * (bx - ax) / rise)).sum(axis=-1) % 2 == 1
    within: Flags = odd | touches(points, points, zone)
    return within


def touches(start: Array, end: Array, zone: Array) -> Flags:
    """Return whether straight ways from `start` to `end`, [..., 2] m each, meet a zone's border."""
    return np.asarray(meet(start[..., None, :], end[..., None, :], zone, following(zone)).any(axis=-1))


def following(zone: Array) -> Array:
    """Return the corner after each one; `np.roll` takes ten times as long."""
    return np.concatenate((zone[1:], zone[:1]))


def meet(a: Array, b: Array, c: Array, d: Array) -> Flags:
    """Return whether the straight ways from `a` to `b` and from `c` to `d`, [..., 2] m each, have a point in common."""
    apart = (np.maximum(a, b) < np.minimum(c, d)) | (np.maximum(c, d) < np.minimum(a, b))
    across = (turn(a, b, c) * turn(a, b, d) <= 0.0) & (turn(c, d, a) * turn(c, d, b) <= 0.0)
    return np.asarray(across & ~apart.any(axis=-1), np.bool_)


def turn(a: Array, b: Array, c: Array) -> Array:
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
