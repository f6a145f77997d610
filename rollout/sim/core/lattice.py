"""The lattice's formula, compiled for single numbers."""

from collections.abc import Callable
from typing import Final

import numpy as np

from eia_sec.common.actions import lattice
from eia_sec.rollout.sim.core.compile import allocation_free

One = Callable[[np.float32], np.float32]
Two = Callable[[np.float32, np.float32], np.float32]
Three = Callable[[np.float32, np.float32, np.float32], np.float32]
Five = Callable[[np.float32, np.float32, np.float32, np.float32, np.float32], np.float32]

share_of: Final[One] = allocation_free(lattice.share_of)
cell_at: Final[Two] = allocation_free(lattice.cell_at)
cell_beside: Final[Three] = allocation_free(lattice.cell_beside)
velocity_to: Final[Five] = allocation_free(lattice.velocity_to)
