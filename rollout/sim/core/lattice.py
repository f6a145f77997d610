"""The lattice's formula, compiled for single numbers."""

from typing import Final

from eia_sec.common.actions import lattice
from eia_sec.rollout.sim.core.compile import allocation_free

share_of: Final = allocation_free(lattice.share_of)
cell_at: Final = allocation_free(lattice.cell_at)
cell_beside: Final = allocation_free(lattice.cell_beside)
velocity_to: Final = allocation_free(lattice.velocity_to)
