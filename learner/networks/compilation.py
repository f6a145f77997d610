"""How the learner's kernels are compiled."""

from collections.abc import Callable
from typing import Any, Final, TypeVar, cast

import numba

from eia_sec.common.compiled_code import require_cache

require_cache()

Function = TypeVar("Function", bound=Callable[..., Any])
FASTMATH: Final = {"reassoc", "contract", "nsz"}
"""What the compiler may assume: sums may be reordered for vector instructions, but numbers need not be finite."""


def compiled(function: Function) -> Function:
    """Compile a function; the machine code is kept on disk."""
    return cast(Function, numba.njit(nogil=True, fastmath=FASTMATH, error_model="numpy", cache=True)(function))


def shared(function: Function) -> Function:
    """Compile a function whose loop over `prange` runs on as many cores as numba may use."""
    return cast(Function, numba.njit(nogil=True, parallel=True, error_model="numpy", cache=True)(function))
