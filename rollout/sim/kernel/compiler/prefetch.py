"""Prefetches the next environment while this one steps. In a large batch its memory has left the caches."""

from collections.abc import Callable
from typing import Any, Final, cast

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from eia_sec.rollout.sim.kernel.arrays import State
from eia_sec.rollout.sim.kernel.compiler.decorators import allocation_free, inlined

LINE: Final = 64
"""Size of a cache line, bytes."""
READ, SECOND_LEVEL, DATA = 0, 2, 1


def _type_prefetch(typing: Any, address: Any) -> Any:
    """Prefetch the cache line at an address. An invalid address does no harm."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        number = ir.IntType(32)
        pointer = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.VoidType(), [pointer, number, number, number])
        instruction = builder.module.declare_intrinsic("llvm.prefetch", [pointer], kind)
        place = builder.inttoptr(arguments[0], pointer)
        builder.call(instruction, [place, number(READ), number(SECOND_LEVEL), number(DATA)])
        return context.get_dummy_value()

    return types.void(types.int64), generate


_prefetch_line: Final = cast(Callable[[int], None], intrinsic(_type_prefetch))


@allocation_free
def _prefetch_array(array: NDArray[Any]) -> None:
    first = array.ctypes.data
    for line in range(0, array.size * array.itemsize, LINE):
        _prefetch_line(first + line)


@inlined
def prefetch(state: State, e: int) -> None:
    """Prefetch the memory that a step of an environment reads most.

    Args:
        state: the environments.
        e: index of the environment.
    """
    _prefetch_array(state.sensor[e])
    _prefetch_array(state.cell_start[e])
    _prefetch_array(state.age[e])
    _prefetch_array(state.age_due[e])
    _prefetch_array(state.cycle[e])
    _prefetch_array(state.level[e])
    _prefetch_array(state.age_below[e])
    _prefetch_array(state.age_above[e])
    _prefetch_array(state.level_below[e])
    _prefetch_array(state.level_above[e])
    _prefetch_array(state.listed[e])
    _prefetch_array(state.observation[e])
    _prefetch_array(state.parts[e])
