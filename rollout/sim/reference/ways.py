"""Ways round no-fly zones over the points of the lattice, as the reference farm finds them: paths in a graph."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.farm.polygons import refused
from eia_sec.common.farm import COLLECTION, MONITORING, inset_of, lattice_of
from eia_sec.rollout.sim.boxes import inside
from eia_sec.rollout.sim.sweep_routes import plot_boxes

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]
Point = tuple[int, int]


class Ways:
    """The steps that zones leave between neighbouring lattice points.

    A step is possible if no zone refuses it from any corner of the rectangle in which UAVs stand in the one cell to any
    corner of that in the other.

    Args:
        config: the farm.
        zones: corners of each zone, [C, 2] m.
    """

    def __init__(self, config: FarmConfig, zones: tuple[Array, ...]) -> None:
        lattice, world = lattice_of(config.world), config.world
        self._config, self._counts = config, (lattice.columns, lattice.rows)
        self._cell = np.array([world.field_x / lattice.columns, world.field_y / lattice.rows])
        index = np.moveaxis(np.indices(self._counts), 0, -1).reshape(-1, 2)
        self.middle = (index + 0.5) * self._cell
        self.possible = np.zeros((len(index), 3, 3), np.bool_)
        corners, start = self._corners(), np.arange(len(index))
        edges: list[tuple[NDArray[np.int64], NDArray[np.int64]]] = []
        for dx, dy in np.ndindex(3, 3):
            to = index + np.array((dx - 1, dy - 1))
            free = ((to >= 0) & (to < self._counts)).all(axis=1)
            if (dx, dy) != (1, 1):
                for here in corners:
                    for there in corners:
                        free &= ~refused(self.middle + here, (to + 0.5) * self._cell + there, zones)
            self.possible[:, dx, dy] = free
            edges.append((start[free], to[free] @ (lattice.rows, 1)))
        rows, columns = np.concatenate(edges, axis=1)
        self._graph = csr_array((np.ones(len(rows)), (rows, columns)), shape=(len(index), len(index)))

    def _corners(self) -> Array:
        away = 0.5 - min(inset_of(self._config, MONITORING), inset_of(self._config, COLLECTION))
        corners: Array = np.array([(x, y) for x in {-away, away} for y in {-away, away}]) * self._cell
        return corners

    def allows(self, start: Point, end: Point) -> bool:
        """Return whether a step between neighbouring points is possible."""
        column, row = np.subtract(end, start) + 1
        return bool(self.possible[start[0] * self._counts[1] + start[1], column, row])

    def steps(self, plot: int, places: Array) -> Array:
        """Return the steps from the cells of places to a plot, [K]; where no way leads, the number of points.

        Args:
            plot: the plot, row-major.
            places: [K, 2] m.
        """
        found = dijkstra(self._graph, indices=self._goals(plot), unweighted=True, min_only=True)
        steps: Array = np.where(np.isfinite(found), found, len(found))[self._cells(places) @ (self._counts[1], 1)]
        return steps

    def is_closed(self, plot: int) -> bool:
        """Return whether no way leads to a plot from most of the field."""
        return not bool((self._component[self._goals(plot)] == np.bincount(self._component).argmax()).any())

    @functools.cached_property
    def _component(self) -> NDArray[np.int32]:
        found: NDArray[np.int32] = connected_components(self._graph, directed=False)[1]
        return found

    def _goals(self, plot: int) -> NDArray[np.int64]:
        """Return the points in the box of a plot, and the one whose cell holds its middle."""
        box = plot_boxes(self._config)[:, plot]
        own = self._cells(box.mean(axis=0)[None]) @ (self._counts[1], 1)
        return np.union1d(np.flatnonzero(inside(self.middle, box)), own)

    def _cells(self, places: Array) -> NDArray[np.int64]:
        cells: NDArray[np.int64] = np.minimum(places // self._cell, np.subtract(self._counts, 1)).astype(np.int64)
        return cells


def ways_of(config: FarmConfig, zones: tuple[Array, ...]) -> Ways | None:
    """Return the ways of a farm, if there are zones and something that leads round them."""
    seen = config.observation
    return Ways(config, zones) if config.zones.some and (seen.route or seen.plan > 0) else None
