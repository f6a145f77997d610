"""Where a farm's sensors stand: a pure function of the farm's integer seed."""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from common.config import FarmConfig, WorldConfig
from common.errors import ConfigError
from common.seeds import stream
from rollout.kernel.compiled import compiled_entry, sources_digest

CELL: Final = 25.0
"""Edge of the cells by which sensors are numbered, m; larger when that would give more than MAX_CELLS an axis."""
MAX_CELLS: Final = 128
"""Most cells along one axis."""
BLOCKS: Final = 64
"""Blocks of candidate places that are tried before a layout is given up."""
DENSITY_FLOOR: Final = 0.15
"""Least acceptance of a candidate place; 1 in the densest parts."""


@dataclass(frozen=True, eq=False)
class Layout:
    """One farm. All arrays are read-only.

    Attributes:
        seed: the farm's seed.
        sensor_xy: [S, 2] places, m; numbered cell by cell, cells in row-major order (x outer).
        sensor_type: [S] type, 0 .. I_type - 1.
        sensor_cycle_steps: [S] AoI update cycle T_UA of the sensor's type, steps.
        sensor_phase: [S] AoI rises at the steps that leave this remainder by the cycle (0 unless phases are random).
        plot_phase: [n_px, n_py] the same for VDF.
        cells: cells along x and y.
        cell_start: [cells + 1] first sensor of each cell.
    """

    seed: int
    sensor_xy: NDArray[np.float64]
    sensor_type: NDArray[np.int64]
    sensor_cycle_steps: NDArray[np.int64]
    sensor_phase: NDArray[np.int64]
    plot_phase: NDArray[np.int64]
    cells: tuple[int, int]
    cell_start: NDArray[np.int64]


@functools.lru_cache(maxsize=256)
def make_layout(farm: FarmConfig, seed: int) -> Layout:
    """Return the farm of a seed: irregular density, sensors at least `sensor_spacing` apart, balanced types.

    Raises:
        ConfigError: so many sensors do not fit at that spacing.
    """
    world = farm.world
    xy, (cells, start) = _number(world, _place(world, seed))
    random = stream(seed, "layout", "types")
    kind = random.permutation(np.arange(world.sensors) % len(world.sensor_cycles))
    steps = np.rint(np.array(world.sensor_cycles) / world.step_seconds).astype(np.int64)[kind]
    phase, plot_phase = np.zeros_like(steps), np.zeros((world.plots_x, world.plots_y), np.int64)
    if world.cycle_phase == "random":
        phase = random.integers(steps)
        plot_phase = random.integers(round(world.vdf_cycle / world.step_seconds), size=plot_phase.shape)
    for array in (xy, kind, steps, phase, plot_phase, start):
        array.setflags(write=False)
    return Layout(seed, xy, kind, steps, phase, plot_phase, cells, start)


def cell_counts(world: WorldConfig) -> tuple[int, int]:
    """Return the number of cells along x and y."""
    x, y = (min(MAX_CELLS, max(1, int(size // CELL))) for size in (world.field_x, world.field_y))
    return x, y


def _number(
    world: WorldConfig, xy: NDArray[np.float64]
) -> tuple[NDArray[np.float64], tuple[tuple[int, int], NDArray[np.int64]]]:
    """Sort places [S, 2] by cell; return them, the numbers of cells and each cell's first place."""
    cells = cell_counts(world)
    column = np.minimum((xy[:, 0] / world.field_x * cells[0]).astype(np.int64), cells[0] - 1)
    row = np.minimum((xy[:, 1] / world.field_y * cells[1]).astype(np.int64), cells[1] - 1)
    cell = column * cells[1] + row
    start = np.searchsorted(np.sort(cell), np.arange(cells[0] * cells[1] + 1)).astype(np.int64)
    return np.ascontiguousarray(xy[np.argsort(cell, kind="stable")]), (cells, start)


def _place(world: WorldConfig, seed: int) -> NDArray[np.float64]:
    """Throw darts: candidates thinned by the farm's density, each kept if it is far enough from all before it."""
    random = stream(seed, "layout", "sensors")
    size = np.array([world.field_x, world.field_y])
    hills = int(random.integers(3, 8))
    centre = random.uniform(0.0, 1.0, (hills, 2))
    width = random.uniform(0.08, 0.25, hills)
    height = random.uniform(0.3, 1.0, hills)
    place = np.zeros((world.sensors, 2))
    columns, rows = (max(1, int(min(MAX_CELLS, s // max(world.sensor_spacing, 1e-9)))) for s in size)
    first, after = np.full((columns, rows), -1), np.full(world.sensors, -1)
    placed = 0
    for _ in range(BLOCKS):
        candidate = random.uniform(0.0, 1.0, (max(1024, 4 * world.sensors), 2))
        distance = np.linalg.norm(candidate[:, None] - centre, axis=2)
        density = DENSITY_FLOOR + (height * np.exp(-0.5 * (distance / width) ** 2)).sum(axis=1)
        kept = candidate[random.uniform(0.0, 1.0, len(candidate)) < density] * size
        placed = _throw(kept, size, world.sensor_spacing, place, placed, first, after)
        if placed == world.sensors:
            return place
    raise ConfigError(
        f"{world.sensors} sensors do not fit into {world.field_x:g} m x {world.field_y:g} m at least "
        f"{world.sensor_spacing:g} m apart."
    )


def _compile_throw(digest: int) -> Callable[..., int]:
    @compiled_entry
    def throw(
        candidate: NDArray[np.float64],
        size: NDArray[np.float64],
        spacing: float,
        place: NDArray[np.float64],
        placed: int,
        first: NDArray[np.int64],
        after: NDArray[np.int64],
    ) -> int:
        """Keep the candidates [K, 2] that lie at least `spacing` from all places; return how many places there are."""
        columns, rows = first.shape
        free = digest > 0
        for k in range(len(candidate)):
            x, y = candidate[k]
            column = min(int(x / size[0] * columns), columns - 1)
            row = min(int(y / size[1] * rows), rows - 1)
            free = True
            for i in range(max(0, column - 1), min(columns, column + 2)):
                for j in range(max(0, row - 1), min(rows, row + 2)):
                    other = first[i, j]
                    while other >= 0 and free:
                        dx, dy = place[other, 0] - x, place[other, 1] - y
                        free = dx * dx + dy * dy >= spacing * spacing
                        other = after[other]
            if free:
                place[placed, 0], place[placed, 1] = x, y
                after[placed] = first[column, row]
                first[column, row] = placed
                placed += 1
            if placed == len(place):
                break
        return placed

    return throw


_throw = _compile_throw(sources_digest())
