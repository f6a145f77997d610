"""Where UAVs are as shares of the field and of their plot, and the signs of their own axes (W24).

The middle of the field is exactly 0, on every processor, because the subtraction comes first.
"""

from eia_sec.common.config.farm import ObservationConfig
from eia_sec.rollout.sim.core.compile import allocation_free
from eia_sec.rollout.sim.core.constants import CameraConstants, FleetConstants
from eia_sec.rollout.sim.core.records import Array


@allocation_free
def along_side(x: float, side: float, per_side: float) -> float:
    """Return a place along a side of the field, which spans -1 to 1."""
    return (2.0 * x - side) * per_side


@allocation_free
def in_field(fleet: FleetConstants, position: Array, u: int) -> tuple[float, float]:
    """Return a UAV's place in the field, which spans -1 to 1 along both axes."""
    x = along_side(position[u, 0], fleet.width, fleet.per_width)
    return x, along_side(position[u, 1], fleet.depth, fleet.per_depth)


@allocation_free
def in_plot(camera: CameraConstants, position: Array, u: int) -> tuple[int, int, float, float]:
    """Return the column and row of the plot under a UAV, and its place there; the plot spans -1 to 1."""
    x, y = position[u, 0] / camera.plot_width, position[u, 1] / camera.plot_depth
    column, row = min(int(x), camera.plots_x - 1), min(int(y), camera.plots_y - 1)
    return column, row, 2.0 * (x - column) - 1.0, 2.0 * (y - row) - 1.0


@allocation_free
def sign_of(what: ObservationConfig, place: float) -> float:
    """Return the sign of a UAV's axis, from its place along it: -1 where a mirrored view flips the axis."""
    return -1.0 if what.mirrored and place < 0.0 else 1.0
