"""Sensor positions of a farm: a pure function of the farm's integer seed, or given by the configuration."""

import functools
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig, WorldConfig
from eia_sec.common.seeds import stream
from eia_sec.rollout.sim.conditions.zones import make_zones
from eia_sec.rollout.sim.core.cells import cell_counts
from eia_sec.rollout.sim.densities import density_of
from eia_sec.rollout.sim.poisson_disk import sample_positions

GIVEN: Final = "given"
"""Density of a layout whose positions come from the configuration."""


@dataclass(frozen=True, eq=False)
class Layout:
    """One farm. All arrays are read-only.

    Attributes:
        seed: the farm's seed.
        density: density from which the positions were sampled, or GIVEN.
        sensor_xy: [S, 2] positions, m; numbered cell by cell, cells in row-major order (x outer).
        sensor_type: [S] type, 0 .. I_type - 1.
        sensor_cycle_steps: [S] AoI update cycle T_UA of the sensor's type, steps.
        cells: number of cells along x and y.
        cell_start: [cells + 1] first sensor of each cell.
        zones: corners of each no-fly zone, [C, 2] m.
    """

    seed: int
    density: str
    sensor_xy: NDArray[np.float64]
    sensor_type: NDArray[np.int64]
    sensor_cycle_steps: NDArray[np.int64]
    cells: tuple[int, int]
    cell_start: NDArray[np.int64]
    zones: tuple[NDArray[np.float64], ...] = ()


@functools.lru_cache(maxsize=256)
def make_layout(farm: FarmConfig, seed: int) -> Layout:
    """Return the farm of a seed.

    Positions are sampled from the configured density, at least `sensor_spacing` apart, and types are balanced.
    Positions and types from the configuration stay as they are.

    Raises:
        ConfigError: the sensors do not fit at that spacing.
    """
    world = farm.world
    density = GIVEN if world.sites else density_of(world, seed)
    given = np.array(world.sites, np.float64)
    place = given[:, :2] if world.sites else sample_positions(world, seed, density)
    order, (cells, start) = _number(world, place)
    kind = stream(seed, "layout", "types").permutation(np.arange(world.sensors) % len(world.sensor_cycles))
    if world.sites and given.shape[1] > 2:
        kind = given[order, 2].astype(np.int64)
    steps = np.rint(np.array(world.sensor_cycles) / world.step_seconds).astype(np.int64)[kind]
    xy = np.ascontiguousarray(place[order])
    for array in (xy, kind, steps, start):
        array.setflags(write=False)
    return Layout(seed, density, xy, kind, steps, cells, start, make_zones(farm, seed))


def _number(
    world: WorldConfig, xy: NDArray[np.float64]
) -> tuple[NDArray[np.intp], tuple[tuple[int, int], NDArray[np.int64]]]:
    """Return the order that sorts positions [S, 2] by cell, the cells per axis and each cell's first position."""
    cells = cell_counts(world)
    column = np.minimum((xy[:, 0] / world.field_x * cells[0]).astype(np.int64), cells[0] - 1)
    row = np.minimum((xy[:, 1] / world.field_y * cells[1]).astype(np.int64), cells[1] - 1)
    cell = column * cells[1] + row
    start = np.searchsorted(np.sort(cell), np.arange(cells[0] * cells[1] + 1)).astype(np.int64)
    return np.argsort(cell, kind="stable"), (cells, start)


@functools.lru_cache(maxsize=256)
def by_rows(layout: Layout) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the sensors ordered by rows of cells, [S], and where each cell begins in that list, [cells + 1]."""
    columns, rows = layout.cells
    number = np.diff(layout.cell_start)
    cell = np.arange(columns * rows).reshape(columns, rows)
    order = np.argsort(np.repeat((cell % rows * columns + cell // rows).ravel(), number), kind="stable")
    return order, np.concatenate(([0], np.cumsum(number.reshape(columns, rows).T)))
