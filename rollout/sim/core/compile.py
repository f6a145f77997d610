"""How the simulator's functions are compiled.

    @compiled                a function that other compiled functions call
    @allocation_free         the same, and the compiler refuses it if it could allocate memory
    @inlined                 the same, copied into its callers: for functions that take whole records
    @compiled_entry          a function that Python calls; its machine code is kept on disk
    @allocation_free_entry   the same, allocation-free

Numba keys the machine code on disk only by the entry's own file, not by the files of the functions that it calls. The
two entry decorators add a digest of all the simulator's sources to that key, and one of those in the entry's folder, so
any change recompiles the entries. The digests are those of the sources at import: code of sources that change under a
running process must not pass for code of the new.
"""

import functools
import hashlib
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar, cast

import numba

from eia_sec.common import farm_observation
from eia_sec.common.actions import lattice
from eia_sec.common.compiled_code import require_cache
from eia_sec.rollout.sim.core.copies import Compiler

require_cache()

Function = TypeVar("Function", bound=Callable[..., Any])

STRICT: Final[dict[str, Any]] = {
    "nogil": True,
    "fastmath": False,
    "error_model": "numpy",
    "pipeline_class": Compiler,
}
"""Strict arithmetic, so that results are bit-equal everywhere, and a compiler that takes half the time."""
ALLOCATION_FREE: Final[dict[str, Any]] = {**STRICT, "_nrt": False}
"""Compile without Numba's runtime, so that the compiler refuses code that allocates memory or counts references."""


def compiled(function: Function) -> Function:
    """Compile a function that other compiled functions call."""
    return cast(Function, numba.njit(**STRICT)(function))


def allocation_free(function: Function) -> Function:
    """Compile a function that must not allocate memory."""
    return cast(Function, numba.njit(**ALLOCATION_FREE)(function))


def inlined(function: Function) -> Function:
    """Inline an allocation-free function into its callers, because passing whole records costs more than its work."""
    return cast(Function, numba.njit(inline="always", **ALLOCATION_FREE)(function))


def compiled_entry(function: Function) -> Function:
    """Compile a function that Python calls, and keep the machine code on disk."""
    return cast(Function, _keyed_by_sources(numba.njit(cache=True, **STRICT)(function)))


def allocation_free_entry(function: Function) -> Function:
    """Compile an entry as `compiled_entry` does; it must not allocate memory."""
    return cast(Function, _keyed_by_sources(numba.njit(cache=True, **ALLOCATION_FREE)(function)))


def _keyed_by_sources(dispatcher: Any) -> Any:
    """Add the digests of all sources of the simulator, and of its folder, to a function's key on disk."""
    cache = dispatcher._cache
    plain_key, digests = (
        cache._index_key,
        (sources_digest(), _folder_digest(Path(dispatcher.py_func.__code__.co_filename))),
    )
    cache._index_key = lambda signature, codegen: (*plain_key(signature, codegen), *digests)
    return dispatcher


def _folder_digest(source: Path) -> str:
    """Return a digest of the sources beside a file, whose functions an entry in it may call."""
    digest = hashlib.sha256()
    for path in sorted(source.parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()


@functools.cache
def sources_digest() -> str:
    """Return a digest of all sources of the simulator, and of those of common whose constants or code it compiles."""
    simulator, digest = Path(__file__).parents[1], hashlib.sha256()
    sources = sorted(path for path in simulator.rglob("*.py") if path.parent.name != "reference")
    for path in (*sources, *(Path(inspect.getfile(module)) for module in (farm_observation, lattice))):
        digest.update(path.read_bytes())
    return digest.hexdigest()
