"""Checks of a watched farm's frames before they are drawn."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.errors import SchemaError
from eia_sec.common.farm import farm_team
from eia_sec.common.protocol.messages import ViewMessage

FRAMES: Final = 32
"""Most frames in one message."""
MAX_PARTS: Final = 32
"""Most parts of a reward."""
NO_RELAY: Final = 255
"""Assignment of a UAV that has no relay."""
EDGE: Final = 1e-3
"""Rounding error allowed for a position at the field's edge, m."""


def check_view(message: ViewMessage, farm: FarmConfig, parts: int) -> None:
    """Raise SchemaError unless a message fits the farm that its sender announced.

    Args:
        message: the received message.
        farm: the configuration in the worker's answer.
        parts: K, the number of reward parts in that answer.
    """
    world = farm.world
    frames = len(message.position) if message.position.ndim else 0
    served = world.monitoring_uavs + world.collection_uavs
    types = len(farm_team(farm).groups)
    wanted = {
        "position": (frames, world.uavs, 2),
        "assignment": (frames, served),
        "quality": (frames, served),
        "aoi": (frames, world.sensors),
        "vdf": (frames, world.plots_x, world.plots_y),
        "level": (frames, 2),
        "parts": (frames, types, parts),
        **_optional_shapes(message, farm, frames),
    }
    if not 1 <= frames <= FRAMES:
        raise SchemaError(f"a view has {frames} frames, not 1 to {FRAMES}.")
    for name, shape in wanted.items():
        if getattr(message, name).shape != shape:
            raise SchemaError(f"array {name} is {list(getattr(message, name).shape)}, not {list(shape)}.")
    for name in ("position", "quality", "level", "parts"):
        if not np.isfinite(getattr(message, name)).all():
            raise SchemaError(f"array {name} holds a number that is not finite.")
    _within(message.position, np.array([world.field_x, world.field_y]) + EDGE, -EDGE, "position")
    _within(message.level, np.array([world.aoi_max, world.vdf_max]) + EDGE, -EDGE, "level")
    linked = message.assignment[message.assignment != NO_RELAY]
    _within(linked, np.array(world.communication_uavs - 1), 0.0, "assignment")
    for flags in (message.gone, message.known):
        if flags is not None and (flags > 1).any():
            raise SchemaError("a flag is neither 0 nor 1.")
    if message.first + frames > world.steps + 1:
        raise SchemaError(f"a view reaches step {message.first + frames - 1} of {world.steps}.")


def _optional_shapes(message: ViewMessage, farm: FarmConfig, frames: int) -> dict[str, tuple[int, ...]]:
    """Return the shapes of those optional arrays that the farm has a use for.

    Raises:
        SchemaError: one of them is missing, or there is one for which the farm has no use.
    """
    shapes = {
        "gone": (farm.loses_uavs, (frames, farm.world.uavs)),
        "charge": (farm.battery.some, (frames, farm.world.uavs)),
        "known": (farm.stress.patches > 0, (frames, farm.stress.patches)),
    }
    for name, (wanted, _) in shapes.items():
        if wanted != (getattr(message, name) is not None):
            raise SchemaError(f"array {name} is {'missing' if wanted else 'of no use in this farm'}.")
    return {name: shape for name, (wanted, shape) in shapes.items() if wanted}


def _within(values: NDArray[Any], most: NDArray[np.float64], least: float, name: str) -> None:
    if (values < least).any() or (values > most).any():
        raise SchemaError(f"array {name} leaves its range.")
