"""How close a row of observations of the compiled farm comes to the reference's."""

import numpy as np

from eia_sec.common.config import FarmConfig
from eia_sec.common.farm import farm_environment
from eia_sec.common.farm_observation import field_rounding

ROUGH = 1e-6
"""Float32's resolution."""


def observation_tolerance(config: FarmConfig) -> np.ndarray:
    """Return the absolute tolerance of each number of a row, [O]."""
    spec, fields, rows = farm_environment(config), field_rounding(config.world), list[float]()
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
