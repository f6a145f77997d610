"""Memory of the next environment, asked for while this one is stepped: in a large batch it has left the caches."""

from collections.abc import Callable
from typing import Any, Final, cast

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from rollout.sim.kernel.arrays import State
from rollout.sim.kernel.compiler.decorators import merged, sealed

LINE: Final = 64
"""Bytes that the processor fetches together."""
READ, SECOND_LEVEL, DATA = 0, 2, 1


def _type_ask(typing: Any, address: Any) -> Any:
    """Ask for the line at an address; nothing is wrong with an address at which there is none."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        number = ir.IntType(32)
        pointer = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [pointer, number, number, number])
        prefetch = builder.module.declare_intrinsic("llvm.prefetch", [pointer], kind)
        place = builder.inttoptr(arguments[0], pointer)
        builder.call(prefetch, [place, number(READ), number(SECOND_LEVEL), number(DATA)])
        return context.get_dummy_value()

    return types.void(types.int64), generate


_ask: Final = cast(Callable[[int], None], intrinsic(_type_ask))


@sealed
def _ask_for(array: NDArray[Any]) -> None:
    first = array.ctypes.data
    for line in range(0, array.size * array.itemsize, LINE):
        _ask(first + line)


@merged
def ask_for(state: State, e: int) -> None:
    """Ask for what a step of an environment reads most of.

    Args:
        state: the environments.
        e: which.
    """
    _ask_for(state.sensor[e])
    _ask_for(state.cell_start[e])
    _ask_for(state.age[e])
    _ask_for(state.age_due[e])
    _ask_for(state.cycle[e])
    _ask_for(state.level[e])
    _ask_for(state.age_below[e])
    _ask_for(state.age_above[e])
    _ask_for(state.level_below[e])
    _ask_for(state.level_above[e])
    _ask_for(state.listed[e])
    _ask_for(state.observation[e])
    _ask_for(state.parts[e])
