"""Wind, and no-fly zones.

The commanded velocity is that over ground. A UAV flies through air that moves with the wind w, so its airspeed is the
commanded velocity less w, along each axis clipped to the top speed; over ground it makes the airspeed plus w.

A zone is a closed polygon. A move that would end in one or cross one is refused: the UAV stays where it was, which
counts as a boundary violation, ACT, like one at the field's edge.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.farm.polygons import following
from eia_sec.rollout.sim.kernel.compiler.decorators import allocation_free, allocation_free_entry

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.int64]


class AirspaceConstants(NamedTuple):
    """What is in the air.

    Attributes:
        wind: whether wind blows.
        zones: whether there are no-fly zones.
        first: [Z + 1] first side of each zone.
    """

    wind: bool
    zones: bool
    first: Indices


def airspace(config: FarmConfig) -> AirspaceConstants:
    """Derive the numbers of wind and zones."""
    first = np.cumsum([0, *config.zones.corners], dtype=np.int64)
    return AirspaceConstants(wind=config.wind.some, zones=config.zones.some, first=first)


def zone_sides(zones: tuple[Array, ...]) -> tuple[Array, Array]:
    """Return the sides of all zones, [K, 4] as x, y of both ends, and the boxes around them, [Z, 4], m."""
    sides = [np.concatenate([zone, following(zone)], axis=1) for zone in zones]
    boxes = [np.concatenate([zone.min(axis=0), zone.max(axis=0)]) for zone in zones]
    return np.concatenate([np.zeros((0, 4)), *sides]), np.array(boxes).reshape(-1, 4)


@allocation_free
def ground_speed(commanded: float, wind: float, top: float) -> float:
    """Return the speed over ground along an axis, m/s: as commanded, where the airspeed is at most the top speed."""
    return min(wind + top, max(wind - top, commanded))


@allocation_free
def _turn(ax: float, ay: float, bx: float, by: float, cx: float, cy: float) -> float:
    """Return twice the signed area of a triangle."""
    return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)


@allocation_free
def _meets(x: float, y: float, to_x: float, to_y: float, side: Array) -> bool:
    """Return whether a straight way meets a side."""
    ax, ay, bx, by = side[0], side[1], side[2], side[3]
    if max(x, to_x) < min(ax, bx) or max(ax, bx) < min(x, to_x) or max(y, to_y) < min(ay, by):
        return False
    if max(ay, by) < min(y, to_y):
        return False
    if _turn(x, y, to_x, to_y, ax, ay) * _turn(x, y, to_x, to_y, bx, by) > 0.0:
        return False
    return _turn(ax, ay, bx, by, x, y) * _turn(ax, ay, bx, by, to_x, to_y) <= 0.0


@allocation_free
def refused(first: Indices, side: Array, box: Array, x: float, y: float, to_x: float, to_y: float) -> bool:
    """Return whether a move ends in a zone or crosses one; one that leads nowhere never is.

    Args:
        first: [Z + 1] first side of each zone.
        side: [K, 4] the sides, m.
        box: [Z, 4] the boxes around the zones: least x and y, largest x and y, m.
        x: where the move begins, m.
        y: the same along y, m.
        to_x: where it ends, m.
        to_y: the same along y, m.
    """
    if x == to_x and y == to_y:
        return False
    for zone in range(len(box)):
        if max(x, to_x) < box[zone, 0] or min(x, to_x) > box[zone, 2]:
            continue
        if max(y, to_y) < box[zone, 1] or min(y, to_y) > box[zone, 3]:
            continue
        if _in_or_across(first[zone], first[zone + 1], side, x, y, to_x, to_y):
            return True
    return False


@allocation_free
def _in_or_across(start: int, stop: int, side: Array, x: float, y: float, to_x: float, to_y: float) -> bool:
    """Return whether a way meets the border of the zone with these sides, or ends inside it."""
    inside = False
    for k in range(start, stop):
        if _meets(x, y, to_x, to_y, side[k]):
            return True
        ax, ay, bx, by = side[k, 0], side[k, 1], side[k, 2], side[k, 3]
        if (ay > to_y) != (by > to_y) and to_x < ax + (to_y - ay) * (bx - ax) / (by - ay):
            inside = not inside
    return inside


@allocation_free_entry
def refuse_moves(first: Indices, side: Array, box: Array, start: Array, end: Array, found: Flags) -> None:
    """Find out which moves from `start` to `end`, [n, 2] m each, are refused; other arguments as for `refused`."""
    for n in range(len(start)):
        found[n] = refused(first, side, box, start[n, 0], start[n, 1], end[n, 0], end[n, 1])


@allocation_free_entry
def find_inside(first: Indices, side: Array, place: Array, found: Flags) -> None:
    """Find out which places [n, 2] m lie in a zone, its border included; other arguments as for `refused`."""
    for n in range(len(place)):
        x, y = place[n, 0], place[n, 1]
        found[n] = False
        for zone in range(len(first) - 1):
            if _in_or_across(first[zone], first[zone + 1], side, x, y, x, y):
                found[n] = True
                break
