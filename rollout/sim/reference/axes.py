"""Where a UAV of the reference farm is, and the signs of its own axes (W24)."""

import numpy as np
from numpy.typing import NDArray

from eia_sec.rollout.sim.reference.state import FarmState

Array = NDArray[np.float64]


def place_of(farm: FarmState, u: int) -> Array:
    """Return a UAV's position [2]; the field spans -1 to 1."""
    world = farm.config.world
    return np.asarray(2.0 * farm.position[u] / (world.field_x, world.field_y) - 1.0)


def plot_of(farm: FarmState, u: int) -> tuple[NDArray[np.int64], Array]:
    """Return the plot under a UAV, and the UAV's offset from the plot's centre divided by half a plot."""
    world = farm.config.world
    size = np.array([world.field_x / world.plots_x, world.field_y / world.plots_y])
    plot = np.minimum(farm.position[u] // size, (world.plots_x - 1, world.plots_y - 1)).astype(np.int64)
    return plot, 2.0 * (farm.position[u] / size - plot) - 1.0


def signs_of(farm: FarmState, u: int) -> Array:
    """Return the signs of a UAV's axes; both are 1 unless views are mirrored."""
    decides = plot_of(farm, u)[1] if farm.kind[u] == 1 else place_of(farm, u)
    return np.where(farm.config.observation.mirrored & (decides < 0.0), -1.0, 1.0)
