"""The one way in which the simulator's functions are compiled."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])

STRICT: Final[dict[str, Any]] = {"nogil": True, "fastmath": False, "error_model": "numpy"}
"""Strict arithmetic, so that results are bit-equal everywhere."""
SEALED: Final[dict[str, Any]] = {**STRICT, "_nrt": False}
"""Without the compiler's runtime: what would allocate memory or count references is refused by the compiler."""


def compiled(function: Function) -> Function:
    """Compile a function that others call."""
    return cast(Function, numba.njit(**STRICT)(function))


def sealed(function: Function) -> Function:
    """Compile a function of the step, which must not allocate."""
    return cast(Function, numba.njit(**SEALED)(function))


def merged(function: Function) -> Function:
    """Compile a sealed function into those that call it: for those that get a whole farm, which is much to pass."""
    return cast(Function, numba.njit(inline="always", **SEALED)(function))


def compiled_entry(function: Function) -> Function:
    """Compile a function that Python calls, and keep the machine code on disk.

    The function must be a closure over `sources_digest()`: the compiler's cache looks at the entry's own file and
    at what it closes over, but not at the files of the functions that it calls.
    """
    return cast(Function, numba.njit(cache=True, **STRICT)(function))


def sealed_entry(function: Function) -> Function:
    """Do both: keep the machine code on disk, and refuse to allocate."""
    return cast(Function, numba.njit(cache=True, **SEALED)(function))


def sources_digest() -> int:
    """Return a number above 0 that changes with any source of the kernel."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parents[1].rglob("*.py")):
        digest.update(path.read_bytes())
    return 1 + int.from_bytes(digest.digest()[:7], "little")
