"""Poisson-disk sampling from a density: a candidate too close to an earlier one is rejected."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import WorldConfig
from eia_sec.common.errors import ConfigError
from eia_sec.common.seeds import stream
from eia_sec.rollout.sim.core.compile import compiled_entry
from eia_sec.rollout.sim.densities import make_density

BLOCKS: Final = 64
"""Blocks of candidates to try before a layout counts as impossible."""
MAX_BINS: Final = 128
"""Most bins along one axis of the neighbour search."""


def sample_positions(world: WorldConfig, seed: int, kind: str) -> NDArray[np.float64]:
    """Return sensor positions [S, 2] m: candidates thinned by a density, each kept if far enough from earlier ones.

    Args:
        world: sensor count, spacing and field size.
        seed: the farm's seed.
        kind: the density.

    Raises:
        ConfigError: the sensors do not fit at that spacing.
    """
    random = stream(seed, "layout", "sensors")
    size = np.array([world.field_x, world.field_y])
    density = make_density(kind, world, random)
    place = np.zeros((world.sensors, 2))
    columns, rows = (max(1, int(min(MAX_BINS, s // max(world.sensor_spacing, 1e-9)))) for s in size)
    first, after = np.full((columns, rows), -1), np.full(world.sensors, -1)
    placed = 0
    for _ in range(BLOCKS):
        candidate = random.uniform(0.0, 1.0, (max(1024, 4 * world.sensors), 2))
        share = density(candidate)
        kept = candidate[random.uniform(0.0, 1.0, len(candidate)) < share] * size
        placed = _keep_spaced(kept, size, world.sensor_spacing, place, placed, first, after)
        if placed == world.sensors:
            return place
    raise ConfigError(
        f"{world.sensors} sensors at least {world.sensor_spacing:g} m apart do not fit into "
        f"{world.field_x:g} m x {world.field_y:g} m."
    )


@compiled_entry
def _keep_spaced(
    candidate: NDArray[np.float64],
    size: NDArray[np.float64],
    spacing: float,
    place: NDArray[np.float64],
    placed: int,
    first: NDArray[np.int64],
    after: NDArray[np.int64],
) -> int:
    """Add the candidates [K, 2] at least `spacing` from all kept positions; return how many positions are kept."""
    columns, rows = first.shape
    free = True
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
