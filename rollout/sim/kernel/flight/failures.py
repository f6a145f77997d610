"""UAVs that fail: from the step of its failure on, a UAV is gone.

A UAV that is gone is infinitely far away. So it is nobody's nearest UAV, no plot and no sensor is its own, and nobody
comes close to it; the search loops need not know. What reads one UAV's own position asks `gone` first. `shown` keeps
where it failed, for the public.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.rollout.sim.kernel.arrays import Farm
from eia_sec.rollout.sim.kernel.compiler.decorators import allocation_free, inlined
from eia_sec.rollout.sim.kernel.constants import Constants, Indices
from eia_sec.rollout.sim.kernel.flight.planes import kind_of

Float32 = NDArray[np.float32]

NOBODY: Final = -1
"""The relay of a UAV that has none."""


@inlined
def lose_uavs(c: Constants, farm: Farm) -> bool:
    """Take the UAVs that fail in this step out of the farm; return whether there are any.

    Updates `gone`, `living`, `position` and `direction`.
    """
    lost = False
    for u in range(len(farm.gone)):
        if not farm.gone[u] and farm.failure[u] <= farm.step:
            farm.gone[u], lost = True, True
            farm.living[kind_of(c.fleet, u)] -= 1
            farm.position[u, 0], farm.position[u, 1] = math.inf, math.inf
            farm.direction[u, 0], farm.direction[u, 1] = 0.0, 0.0
    return lost


@inlined
def show_places(farm: Farm) -> None:
    """Write where the UAVs are to `shown`; one that is gone stays there where it failed."""
    for u in range(len(farm.gone)):
        if not farm.gone[u]:
            farm.shown[u, 0], farm.shown[u, 1] = farm.position[u, 0], farm.position[u, 1]


@allocation_free
def capacity_left(capacity: int, living: Indices) -> int:
    """Return how many UAVs each living relay serves: more than its capacity only if not all would be served else."""
    served, relays = living[1] + living[2], max(living[0], 1)
    most: int = max(capacity, (served + relays - 1) // relays)
    return most


@allocation_free
def see_nothing(size: int, seen: Float32, at: int) -> int:
    """Write the observation of a UAV that is gone, zeros; return where it ends."""
    for k in range(at, at + size):
        seen[k] = 0.0
    return at + size
