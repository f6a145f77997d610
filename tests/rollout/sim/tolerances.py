"""How close a row of observations of the compiled farm comes to the reference's."""

import numpy as np

from common.config import FarmConfig
from common.farm import farm_environment
from rollout.sim.kernel.views.constants import field_range

ROUGH = 1e-6
"""Float32's resolution."""


def observation_tolerance(config: FarmConfig) -> np.ndarray:
    """Return the absolute tolerance of each number of a row, [O].

    The compiled value fields are sums of float32; the growth of a field with a move is scaled by range over step.
    """
    world, spec = config.world, farm_environment(config)
    step = (world.speed_x_max + world.speed_y_max) * world.step_seconds
    fields = 4.0 * ROUGH * max(1.0, field_range(world) / step)
    rows = []
    for group in spec.team.groups:
        names = spec.tensor_names[group.name].observation
        rows += [fields if name.startswith(("near_", "far_")) else ROUGH for name in names] * group.count
    return np.array(rows)


def named_columns(config: FarmConfig, *beginnings: str) -> list[int]:
    """Return the numbers of a row of observations whose names begin so."""
    spec, names = farm_environment(config), list[str]()
    for group in spec.team.groups:
        names += [*spec.tensor_names[group.name].observation] * group.count
    return [index for index, name in enumerate(names) if name.startswith(beginnings)]
