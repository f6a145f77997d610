"""The three flight planes: communication (0), monitoring (1) and data collection UAVs (2), in row order."""

from eia_sec.rollout.sim.core.compile import allocation_free
from eia_sec.rollout.sim.core.constants import FleetConstants


@allocation_free
def kind_of(fleet: FleetConstants, u: int) -> int:
    """Return the type of a UAV."""
    if u < fleet.relays:
        return 0
    return 1 if u < fleet.collectors else 2


@allocation_free
def height_of(fleet: FleetConstants, u: int) -> float:
    """Return the flight height of a UAV: H_c, H_m or H_d, m."""
    height: float = fleet.height[u]
    return height
