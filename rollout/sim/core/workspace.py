"""Arguments that are unpacked once instead of at every call.

Unpacking some sixty arrays and a hundred numbers from Python objects costs more than a step of a farm. So a workspace
is written to memory once, in compiled code's own representation, and entry points take only its address.
"""

import copy
from collections.abc import Callable
from typing import Any, Final, cast

import numba
import numpy as np
from numba.core import types
from numba.extending import intrinsic

from eia_sec.common.config import FarmConfig
from eia_sec.common.errors import SimulationError
from eia_sec.common.farm import farm_team
from eia_sec.rollout.sim.core.arrays import Workspace, make_scratch, make_state
from eia_sec.rollout.sim.core.compile import allocation_free_entry
from eia_sec.rollout.sim.core.constants import constants


def make_workspace(config: FarmConfig, environments: int, hindsight: bool = False) -> Workspace:
    """Allocate a workspace, and what tracks visits if `hindsight` is set."""
    action = np.zeros((environments, farm_team(config).environment_action_size), np.float32)
    numbers = constants(config)
    return Workspace(
        numbers,
        make_state(config, numbers, environments, hindsight),
        make_scratch(config, numbers),
        action,
    )


typeof: Final[Callable[[Any], Any]] = numba.typeof
WORKSPACE: Final = typeof(make_workspace(FarmConfig(), 1))
"""The compiler's type of every workspace."""


def _type_size(typing: Any, workspace: Any) -> Any:
    """Return the size of a workspace in bytes."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return context.get_constant(types.int64, context.get_abi_sizeof(context.get_value_type(WORKSPACE)))

    return types.int64(workspace), generate


def _type_store(typing: Any, address: Any, workspace: Any) -> Any:
    """Write a workspace to an address."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = context.get_value_type(WORKSPACE).as_pointer()
        builder.store(arguments[1], builder.inttoptr(arguments[0], place))
        return context.get_dummy_value()

    return types.void(types.int64, workspace), generate


def _type_unpack(typing: Any, address: Any) -> Any:
    """Return the workspace at an address. Its arrays are borrowed: `PackedArguments` keeps them alive."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        place = context.get_value_type(WORKSPACE).as_pointer()
        return builder.load(builder.inttoptr(arguments[0], place))

    return WORKSPACE(types.int64), generate


_size: Final = cast(Callable[[Workspace], int], intrinsic(_type_size))
_store: Final = cast(Callable[[int, Workspace], None], intrinsic(_type_store))
unpack: Final = cast(Callable[[int], Workspace], intrinsic(_type_unpack))


@allocation_free_entry
def _pack(workspace: Workspace, address: int) -> int:
    """Write a workspace to an address unless that is 0; return the size in bytes."""
    if address != 0:
        _store(address, workspace)
    return _size(workspace)


class PackedArguments:
    """A workspace in compiled code's own representation.

    Args:
        workspace: the workspace to pack; this object keeps its arrays alive.

    Attributes:
        workspace: the packed workspace.
        address: its address, for the entry points.

    Raises:
        SimulationError: an array's type differs from the compiled one.
    """

    def __init__(self, workspace: Workspace) -> None:
        if typeof(workspace) != WORKSPACE:
            raise SimulationError("the simulator was not compiled for its arrays' types.")
        self.workspace = workspace
        self._memory = np.zeros(_pack(workspace, 0) // 8 + 1, np.int64)
        self.address: int = self._memory.ctypes.data
        _pack(workspace, self.address)

    def __reduce__(self) -> tuple[type["PackedArguments"], tuple[Workspace]]:
        """Pack the workspace again where a user's wrapper unpickles an environment: addresses do not travel."""
        return PackedArguments, (self.workspace,)

    def __deepcopy__(self, memo: dict[int, Any]) -> "PackedArguments":
        """Pack a copy of the workspace. Packed bytes point at arrays, so copying the bytes would not do."""
        return PackedArguments(copy.deepcopy(self.workspace, memo))
