"""Arguments that are unpacked once, not at every call.

Taking some sixty arrays and a hundred numbers out of Python objects costs more than a step of a farm. So a frame is
turned once into the machine's own form and stored, and the simulator's entrance only gets its address.
"""

import copy
from collections.abc import Callable
from typing import Any, Final, cast

import numba
import numpy as np
from numba.core import types
from numba.extending import intrinsic

from common.config import FarmConfig
from common.errors import SimulationError
from common.team import farm_team
from rollout.sim.kernel.arrays import Frame, make_scratch, make_state
from rollout.sim.kernel.compiler.decorators import sealed_entry, sources_digest
from rollout.sim.kernel.constants import constants
from rollout.sim.layout import cell_counts


def make_frame(config: FarmConfig, environments: int) -> Frame:
    """Allocate a frame."""
    action = np.zeros((environments, farm_team(config).action_size), np.float32)
    return Frame(
        constants(config, cell_counts(config.world)), make_state(config, environments), make_scratch(config), action
    )


typeof: Final[Callable[[Any], Any]] = numba.typeof
FRAME: Final = typeof(make_frame(FarmConfig(), 1))
"""The compiler's type of every frame."""


def _type_size(typing: Any, frame: Any) -> Any:
    """Return how many bytes a frame takes."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return context.get_constant(types.int64, context.get_abi_sizeof(context.get_value_type(FRAME)))

    return types.int64(frame), generate


def _type_store(typing: Any, address: Any, frame: Any) -> Any:
    """Write a frame to an address."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = context.get_value_type(FRAME).as_pointer()
        builder.store(arguments[1], builder.inttoptr(arguments[0], place))
        return context.get_dummy_value()

    return types.void(types.int64, frame), generate


def _type_thaw(typing: Any, address: Any) -> Any:
    """Return the frame at an address. The arrays are borrowed: whoever froze them must keep them."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = context.get_value_type(FRAME).as_pointer()
        return builder.load(builder.inttoptr(arguments[0], place))

    return FRAME(types.int64), generate


_size: Final = cast(Callable[[Frame], int], intrinsic(_type_size))
_store: Final = cast(Callable[[int, Frame], None], intrinsic(_type_store))
thaw: Final = cast(Callable[[int], Frame], intrinsic(_type_thaw))


def _compile_freeze(digest: int) -> Any:
    @sealed_entry
    def freeze(frame: Frame, address: int) -> int:
        """Write a frame to an address unless that is 0; return how many bytes it takes."""
        if address != 0 and digest > 0:
            _store(address, frame)
        return _size(frame)

    return freeze


_freeze = _compile_freeze(sources_digest())


class FrozenFrame:
    """A frame in the machine's own form.

    Args:
        frame: what to store; it is kept, so that its arrays live as long as this object.

    Attributes:
        frame: what is stored.
        address: where.

    Raises:
        SimulationError: an array has another type than every frame.
    """

    def __init__(self, frame: Frame) -> None:
        if typeof(frame) != FRAME:
            raise SimulationError("the simulator's arrays have types that it was not compiled for.")
        self.frame = frame
        self._memory = np.zeros(_freeze(frame, 0) // 8 + 1, np.int64)
        self.address: int = self._memory.ctypes.data
        _freeze(frame, self.address)

    def __deepcopy__(self, memo: dict[int, Any]) -> "FrozenFrame":
        """Return a frame of copied arrays: the stored form points at arrays and cannot be copied as bytes."""
        return FrozenFrame(copy.deepcopy(self.frame, memo))
