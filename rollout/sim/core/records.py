"""Records that compiled code takes: of arrays, each declared once, and of a configuration's numbers.

An array is declared by its type, its axes and its meaning:

    class Example(NamedTuple):
        position: Annotated[Array, "n 2", "of each UAV, m"]
        cell_start: Annotated[Int32, "cells+1", "first sensor of each cell"]

`make_record` allocates the arrays, zeros, given the sizes of the named axes.
"""

import functools
from collections import namedtuple
from collections.abc import Callable, Mapping
from typing import Any, ClassVar, Final, TypeVar, cast, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from eia_sec.rollout.sim.core.compile import inlined

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]
Indices = NDArray[np.int64]
Int32 = NDArray[np.int32]
"""For large per-environment arrays; they take half the memory of 64-bit ones."""
Flags = NDArray[np.bool_]
Site = NDArray[np.uint32]
Steps = NDArray[np.uint16]

Record = TypeVar("Record")
Section = TypeVar("Section")
NUMBERS: Final = (bool, int, float)


def make_record(record: type[Record], sizes: Mapping[str, int], leading: tuple[int, ...] = (), **parts: Any) -> Record:
    """Allocate the arrays of a record.

    Args:
        record: the named tuple that declares them.
        sizes: the size of each named axis.
        leading: axes before those declared.
        parts: fields that are made already.
    """
    arrays = {
        name: np.zeros((*leading, *_shape(hint.__metadata__[0], sizes)), _type(hint.__origin__))
        for name, hint in get_type_hints(record, include_extras=True).items()
        if name not in parts
    }
    return record(**arrays, **parts)


def _shape(axes: str, sizes: Mapping[str, int]) -> list[int]:
    """Return the sizes of axes, each a number, a name or a name+number."""
    parted = (axis.partition("+") for axis in axes.split())
    return [(int(name) if name.isdigit() else sizes[name]) + int(more or 0) for name, _, more in parted]


def _type(array: Any) -> Any:
    """Return the type of the numbers of an array's annotation."""
    return get_args(get_args(array)[1])[0]


def row_maker(record: type[Record]) -> Callable[[Record, int], Record]:
    """Return a compiled function that takes arrays with one more axis, and an index along it, and returns the views.

    Compiled code cannot go through the fields of a record, so the function is written out here.
    """
    fields = ", ".join(f"rows.{name}[index]" for name in get_type_hints(record))
    scope: dict[str, Any] = {"Record": record}
    exec(f"def row(rows, index):\n    return Record({fields})", scope)
    return inlined(cast(Callable[[Record, int], Record], scope["row"]))


def numbers(section: Section) -> Section:
    """Return the numbers of a section of the configuration, constants and properties included, for compiled code.

    Every number has its declared type, so that an integer in a configuration triggers no recompilation. Nor does a
    class that derives from the section's.
    """
    kind_of_section: Any = next(kind for kind in type(section).__mro__ if "__dataclass_fields__" in vars(kind))
    kinds = _kinds(kind_of_section)
    values = [kind(getattr(section, name)) for name, kind in kinds.items()]
    return cast(Section, _tuple_of(kind_of_section)(*values))


@functools.cache
def _kinds(section: Any) -> dict[str, Any]:
    """Return the types of a section's numbers by name."""
    fields = {
        name: get_args(kind)[0] if get_origin(kind) is ClassVar else kind
        for name, kind in get_type_hints(section).items()
    }
    properties = {
        name: get_type_hints(member.fget)["return"]
        for name, member in vars(section).items()
        if isinstance(member, property)
    }
    return {name: kind for name, kind in (fields | properties).items() if kind in NUMBERS}


@functools.cache
def _tuple_of(section: Any) -> Any:
    """Return the tuple of a section's numbers; a name of this module, so that code on disk is found by its type."""
    name, make = section.__name__, cast(Any, namedtuple)
    globals()[name] = made = make(name, tuple(_kinds(section)), module=__name__)
    return made
