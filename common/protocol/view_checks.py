"""Checks of a watched environment's frames before they are drawn."""

import struct
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.environment import MOST_EPISODE_STEPS
from eia_sec.common.errors import SchemaError
from eia_sec.common.farm import farm_team
from eia_sec.common.protocol.messages import StepsMessage, ViewMessage
from eia_sec.common.team import TeamSpec

FRAMES: Final = 32
"""Most frames in one message."""
MAX_PARTS: Final = 32
"""Most parts of a reward."""
NO_RELAY: Final = 255
"""Assignment of a UAV that has no relay."""
EDGE: Final = 1e-3
"""Rounding error allowed for a position at the field's edge, m."""
MOST_SIDE: Final = 480
"""Most pixels along a side of a picture."""
MOST_PICTURE: Final = 2**20
"""Most bytes of a picture; noise of MOST_SIDE by MOST_SIDE pixels takes two thirds of that."""
MOST_PICTURES: Final = 4 * 2**20
"""Most bytes of all pictures in one message."""
MOST_SENTENCE: Final = 300
"""Most characters of the sentence that says why there are no pictures."""
MOST_AGENT_NAME: Final = 64
_PNG: Final = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"
_SIZE: Final = struct.Struct(">II")


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


def check_steps(message: StepsMessage, team: TeamSpec) -> None:
    """Raise SchemaError unless a message fits the team that its sender announced.

    A picture is not unpacked for that: the first bytes of a PNG file say how many pixels it has.

    Args:
        message: the received message.
        team: the layout of a row in the worker's answer.
    """
    frames = message.frames if message.ends.ndim == 1 else 0
    if not 1 <= frames <= FRAMES:
        raise SchemaError(f"a view has {frames} frames, not 1 to {FRAMES}.")
    for name, shape in {
        "reward": (frames, team.agents),
        "action": (frames, team.environment_action_size),
        "seen": (frames, team.agents, 3),
        "alive": (frames, team.agents),
    }.items():
        if getattr(message, name).shape != shape:
            raise SchemaError(f"array {name} is {list(getattr(message, name).shape)}, not {list(shape)}.")
    for name in ("reward", "action", "seen"):
        if not np.isfinite(getattr(message, name)).all():
            raise SchemaError(f"array {name} holds a number that is not finite.")
    if (message.alive > 1).any():
        raise SchemaError("a flag is neither 0 nor 1.")
    if message.first + frames > MOST_EPISODE_STEPS + 1:
        raise SchemaError(f"a view reaches step {message.first + frames - 1} of {MOST_EPISODE_STEPS}.")
    if len(message.silence) > MOST_SENTENCE:
        raise SchemaError(f"a sentence has {len(message.silence)} characters, not {MOST_SENTENCE} at most.")
    _check_pictures(message.pictures, message.ends.tolist())


def _check_pictures(pictures: NDArray[np.uint8], ends: list[int]) -> None:
    if pictures.ndim != 1 or len(pictures) > MOST_PICTURES or ends[-1] != len(pictures):
        raise SchemaError("the pictures are too many bytes, or not those that their ends tell.")
    for begin, end in pairwise([0, *ends]):
        if not 0 <= end - begin <= MOST_PICTURE:
            raise SchemaError(f"a picture has {end - begin} bytes, not {MOST_PICTURE} at most.")
        if end > begin:
            head = pictures[begin : begin + len(_PNG) + _SIZE.size].tobytes()
            if not head.startswith(_PNG) or end - begin < len(_PNG) + _SIZE.size:
                raise SchemaError("a picture is no PNG file.")
            sides = _SIZE.unpack_from(head, len(_PNG))
            if not all(1 <= side <= MOST_SIDE for side in sides):
                raise SchemaError(f"a picture of {sides[0]} by {sides[1]} pixels; {MOST_SIDE} are allowed.")
