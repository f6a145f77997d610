"""The cells that order a field's sensors."""

from typing import Final

from eia_sec.common.config import WorldConfig
from eia_sec.rollout.sim.core.compile import allocation_free

CELL: Final = 25.0
"""Edge of the cells, m; larger if an axis would otherwise have more than MAX_CELLS."""
MAX_CELLS: Final = 128
"""Most cells along one axis."""


def cell_counts(world: WorldConfig) -> tuple[int, int]:
    """Return the number of cells along x and y."""
    x, y = (min(MAX_CELLS, max(1, int(size // CELL))) for size in (world.field_x, world.field_y))
    return x, y


@allocation_free
def cell_of(share: float, cells: int) -> int:
    """Return the cell at a fraction of the axis, by the same product as the layout's numbering."""
    return int(min(cells - 1.0, max(0.0, share * cells)))
