"""Ways around no-fly zones: from goals to waypoints on the shortest way, by a visibility graph over the zones' corners.

Source: visibility graphs (Lozano-Perez and Wesley 1979).
"""

import functools
from typing import Final

import numpy as np
from scipy.sparse.csgraph import shortest_path

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.farm.polygons import Flags, following
from eia_sec.rollout.sim.boxes import Array, reach
from eia_sec.rollout.sim.conditions.zones import find_inside, refuse_moves, zone_sides
from eia_sec.rollout.sim.layout import Layout

MARGIN: Final = 1.0
"""Distance at which UAVs pass a zone's corners, m."""
NEAR: Final = 0.05
"""Distance from a zone at which UAVs stop, m."""
ARRIVED: Final = 1e-3
"""A UAV this close to its waypoint is there, m."""


class Airspace:
    """The zones of one farm, as those who plan ways see them.

    Args:
        config: the farm.
        zones: corners of each zone, [C, 2] m.
    """

    def __init__(self, config: FarmConfig, zones: tuple[Array, ...]) -> None:
        self._zones, self._reach = zones, reach(config.world)
        self._first = np.cumsum([0, *(len(zone) for zone in zones)], dtype=np.int64)
        self._sides, self._boxes = zone_sides(zones)
        self._size = np.array([config.world.field_x, config.world.field_y])
        around = [_around(zone) for zone in zones]
        points = np.concatenate([np.zeros((0, 2)), *around])
        inside = ((points >= 0.0) & (points <= self._size)).all(axis=1)
        self._nodes = points[inside & ~self.inside(points)]
        apart = np.array([self._lengths(node, self._nodes) for node in self._nodes])
        self._ways = shortest_path(np.where(np.isfinite(apart), apart + 1e-12, 0.0)) if len(apart) else apart

    @property
    def some(self) -> bool:
        """Whether there is any zone."""
        return bool(self._zones)

    def inside(self, points: Array) -> Flags:
        """Return whether places [..., 2] m lie in a zone."""
        found = np.empty(points.shape[:-1], np.bool_)
        find_inside(self._first, self._sides, _rows(points), found.reshape(-1))
        return found

    def refused(self, start: Array, end: Array) -> Flags:
        """Return whether moves between places [..., 2] m end in a zone or cross one."""
        start, end = np.broadcast_arrays(start, end)
        found = np.empty(start.shape[:-1], np.bool_)
        refuse_moves(self._first, self._sides, self._boxes, _rows(start), _rows(end), found.reshape(-1))
        return found

    def waypoints(self, position: Array, goal: Array) -> Array:
        """Return where UAVs must fly first on their shortest ways, [n, 2] m.

        A goal in a zone, or one that no way leads to, is replaced by the nearest place before the zone on a straight
        way, which may be the UAV's own.

        Args:
            position: of the UAVs, [n, 2] m.
            goal: of each, [n, 2] m.
        """
        found = goal.copy()
        for uav in np.flatnonzero(self.refused(position, goal)):
            found[uav] = self._waypoint(position[uav], self._free(position[uav], goal[uav]))
        return found

    def detours(self, position: Array, goal: Array) -> bool:
        """Return whether a UAV has yet to fly around a zone on its way from a place to another, [2] m each."""
        ahead = self.waypoints(position[None], goal[None])[0]
        return bool((ahead != goal).any() and np.abs(ahead - position).max() > ARRIVED)

    def _waypoint(self, position: Array, goal: Array) -> Array:
        if not self.refused(position, goal):
            return goal
        if len(self._nodes) == 0:
            return position
        first, last = self._lengths(position, self._nodes), self._lengths(self._nodes, goal)
        total = first[:, None] + self._ways + last
        start = int(total.min(axis=1).argmin())
        ahead: Array = self._nodes[start] if np.isfinite(total[start].min()) else position
        return ahead

    def _free(self, position: Array, goal: Array) -> Array:
        """Return the goal, or, if it lies in a zone, the place nearest to it that does not and that is on a side."""
        if not self.inside(goal):
            return goal
        sides = [_nearest_outside(zone, goal) for zone in self._zones]
        places = np.concatenate([*sides, self._nodes, position[None]])
        free = ~self.inside(places) & ((places >= 0.0) & (places <= self._size)).all(axis=1)
        places = places[free]
        return np.asarray(places[np.hypot(*(places - goal).T).argmin()]) if len(places) else position

    def _lengths(self, start: Array, end: Array) -> Array:
        """Return the steps that straight ways take; infinite for those that a zone refuses."""
        steps = (np.abs(end - start) / self._reach).max(axis=-1) + 1e-3 * (np.abs(end - start) / self._reach).sum(
            axis=-1
        )
        lengths: Array = np.where(self.refused(start, end), np.inf, steps)
        return lengths


def _rows(places: Array) -> Array:
    """Return places [..., 2] as [n, 2]."""
    return np.ascontiguousarray(places, np.float64).reshape(-1, 2)


def _around(zone: Array) -> Array:
    """Return places MARGIN off the corners of a zone, away from both sides, [C, 2] m."""
    before, after = np.roll(zone, 1, axis=0) - zone, following(zone) - zone
    unit = [way / np.maximum(np.hypot(*way.T), 1e-12)[:, None] for way in (before, after)]
    middle = -(unit[0] + unit[1])
    length = np.hypot(*middle.T)[:, None]
    normal = np.stack([unit[1][:, 1], -unit[1][:, 0]], axis=1)
    out = np.where(length > 1e-6, middle / np.maximum(length, 1e-12), normal)
    places: Array = zone + MARGIN * out
    return places


def _nearest_outside(zone: Array, goal: Array) -> Array:
    """Return for each side of a zone the nearest place to a goal, NEAR off the side on either hand, [2 C, 2] m."""
    way = following(zone) - zone
    length = np.maximum(np.hypot(*way.T), 1e-12)[:, None]
    share = np.clip(((goal - zone) * way).sum(axis=1, keepdims=True) / length**2, 0.0, 1.0)
    normal = np.stack([way[:, 1], -way[:, 0]], axis=1) / length
    places: Array = np.concatenate([zone + share * way + side * NEAR * normal for side in (-1.0, 1.0)])
    return places


@functools.lru_cache(maxsize=64)
def airspace_of(config: FarmConfig, layout: Layout) -> Airspace:
    """Return the airspace of a farm."""
    return Airspace(config, layout.zones)
