"""The three flight planes: communication (0), monitoring (1) and data collection UAVs (2), in row order."""

from rollout.kernel.compiled import sealed
from rollout.kernel.constants import FleetConstants


@sealed
def kind_of(fleet: FleetConstants, u: int) -> int:
    """Return the type of a UAV."""
    if u < fleet.relays:
        return 0
    return 1 if u < fleet.collectors else 2


@sealed
def height_of(fleet: FleetConstants, u: int) -> float:
    """Return the flight height of a UAV: H_c, H_m or H_d, m."""
    height: float = fleet.height[u]
    return height


@sealed
def plane_of(fleet: FleetConstants, u: int) -> tuple[int, int]:
    """Return the first UAV of the same plane and one past the last."""
    kind = kind_of(fleet, u)
    first = 0 if kind == 0 else (fleet.relays if kind == 1 else fleet.collectors)
    last = fleet.relays if kind == 0 else (fleet.collectors if kind == 1 else fleet.uavs)
    return first, last
