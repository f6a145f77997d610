"""The one way in which the simulator's functions are compiled."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def compiled(function: Function) -> Function:
    """Compile a function that others call; strict arithmetic, so that results are bit-equal everywhere."""
    return cast(Function, numba.njit(nogil=True, fastmath=False, error_model="numpy")(function))


def compiled_entry(function: Function) -> Function:
    """Compile a function that Python calls, and keep the machine code on disk.

    The function must be a closure over `sources_digest()`: the compiler's cache looks at the entry's own file and
    at what it closes over, but not at the files of the functions that it calls.
    """
    return cast(Function, numba.njit(nogil=True, fastmath=False, error_model="numpy", cache=True)(function))


def sources_digest() -> int:
    """Return a number above 0 that changes with any source of the kernel."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return 1 + int.from_bytes(digest.digest()[:7], "little")
