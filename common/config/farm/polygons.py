"""The geometry of closed polygons: the border belongs to them."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


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
    return np.asarray(meet(start[..., None, :], end[..., None, :], zone, np.roll(zone, -1, axis=0)).any(axis=-1))


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
