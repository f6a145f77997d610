"""No-fly zones: where they are, which moves they refuse, and what UAVs see of them.

A zone is a closed polygon. A move that would end in one or cross one is refused: the UAV stays where it was, which
counts as a boundary violation, ACT, like one at the field's edge.
"""

import math
from typing import Final

import numpy as np

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.farm.polygons import following
from eia_sec.common.config.farm.zones import LONGEST_SIDE
from eia_sec.common.seeds import stream
from eia_sec.rollout.sim.core.compile import allocation_free, allocation_free_entry
from eia_sec.rollout.sim.core.records import Array, Flags, Float32, Indices
from eia_sec.rollout.sim.stations import station_places

SHORTEST_SIDE: Final = 30.0
"""Shortest side of a drawn zone, m."""
GAP: Final = 20.0
"""Least distance between the circles around two drawn zones, m, so that UAVs can pass between them."""
TRIES: Final = 200
"""Places to try for a zone before the gap is given up."""


def make_zones(config: FarmConfig, seed: int) -> tuple[Array, ...]:
    """Return the zones of a farm, [C, 2] m each: the given ones, then rectangles drawn from its seed.

    Where UAVs have batteries, the drawn ones leave the charging stations free, if there is room.
    """
    zones = [np.array(corners, np.float64) for corners in config.zones.polygons]
    random, size = stream(seed, "layout", "zones"), np.array([config.world.field_x, config.world.field_y])
    stations = [place[None] for place in station_places(config)] if config.battery.some else []
    for _ in range(config.zones.random):
        zones.append(_rectangle(random, size, [*zones, *stations]))
    for zone in zones:
        zone.setflags(write=False)
    return tuple(zones)


def _rectangle(random: np.random.Generator, size: Array, others: list[Array]) -> Array:
    """Return a rectangle in the field, apart from what else is there, [C, 2] m each, where there is room."""
    longest = min(LONGEST_SIDE, 0.6 * float(size.min()))
    sides = random.uniform(min(SHORTEST_SIDE, longest), longest, 2)
    turn = random.uniform(0.0, 0.5 * math.pi)
    along = np.array([[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]])
    shape = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]) * sides @ along
    room, radius = np.abs(shape).max(axis=0), 0.5 * math.hypot(*sides)
    room = np.minimum(room, 0.5 * size)
    for _ in range(TRIES):
        middle = room + random.random(2) * (size - 2.0 * room)
        if all(np.hypot(*(other - middle).T).min() >= radius + GAP for other in others):
            break
    zone: Array = middle + shape
    return zone


def zone_sides(zones: tuple[Array, ...]) -> tuple[Array, Array]:
    """Return the sides of all zones, [K, 4] as x, y of both ends, and the boxes around them, [Z, 4], m."""
    sides = [np.concatenate([zone, following(zone)], axis=1) for zone in zones]
    boxes = [np.concatenate([zone.min(axis=0), zone.max(axis=0)]) for zone in zones]
    return np.concatenate([np.zeros((0, 4)), *sides]), np.array(boxes).reshape(-1, 4)


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


@allocation_free
def find_stopped(
    first: Indices, side: Array, box: Array, x: float, y: float, go_x: Array, go_y: Array, stopped: Flags
) -> None:
    """Find which of nine moves of a UAV a zone would refuse.

    Args:
        first: as for `refused`.
        side: as for `refused`.
        box: as for `refused`.
        x: of the UAV, m.
        y: of the UAV, m.
        go_x: [3] x after each move along the UAV's own axis, m.
        go_y: [3] the same along y, m.
        stopped: [9] out.
    """
    for move in range(9):
        stopped[move] = refused(first, side, box, x, y, go_x[move // 3], go_y[move % 3])


@allocation_free
def put_zones(stopped: Flags, seen: Float32, at: int) -> int:
    """Write 1 for each of nine moves that a zone would refuse; return where they end."""
    for move in range(9):
        seen[at + move] = 1.0 if stopped[move] else 0.0
    return at + 9
