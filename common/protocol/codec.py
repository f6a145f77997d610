"""Encodes a message as a frame and decodes it again, from its dataclass alone.

Scalar fields go into the frame's header and arrays into its body, by name. A field that is None is left out. Decoding
checks every field against its declared type, so every decoded message fits its declaration.
"""

import functools
import math
from collections.abc import Callable
from dataclasses import fields
from types import NoneType, UnionType
from typing import Any, ClassVar, Final, Self, Union, get_args, get_origin, get_type_hints

import numpy as np

from eia_sec.common.errors import SchemaError
from eia_sec.common.protocol import frame

NO_LIMIT: Final = 2**63 - 1
"""The largest integer of a field; as a limit it means that there is none."""


class Message:
    """Base of all messages, which are frozen dataclasses with a KIND of their own."""

    KIND: ClassVar[int] = 0
    MOST_HEADER: ClassVar[int] = 64 * 1024
    """Longest header, bytes; the header holds everything but the arrays."""

    def encode(self) -> bytes:
        """Return the message's frame."""
        scalars: dict[str, Any] = {}
        arrays: dict[str, frame.Array] = {}
        for item in fields(self):  # type: ignore[arg-type]  # every subclass is a dataclass; a test asserts it
            value = getattr(self, item.name)
            if value is None:
                continue
            if isinstance(value, np.ndarray):
                arrays[item.name] = value
            elif isinstance(value, tuple) and value and isinstance(value[0], np.ndarray):
                arrays.update({f"{item.name}.{index}": part for index, part in enumerate(value)})
            else:
                scalars[item.name] = value
        return frame.encode(self.KIND, scalars, arrays)

    @classmethod
    def decode(cls, data: frame.Data) -> Self:
        """Return the message in a frame.

        Raises:
            FrameError, VersionError: when the bytes are not a frame of this message.
            SchemaError: when a field is missing, unknown or of another type.
        """
        scalars, arrays = frame.decode(data, cls.KIND, cls.MOST_HEADER)
        values = {name: read(scalars, arrays) for name, read in _readers(cls)}
        if scalars or arrays:
            raise SchemaError(f"{cls.__name__} has no field {sorted([*scalars, *arrays])[0][:40]!r}.")
        return cls(**values)


Reader = Callable[[dict[str, Any], dict[str, frame.Array]], Any]
"""Removes one field from a frame's scalars or arrays and returns it, checked against its declaration."""


_PLANS: Final[dict[type[Any], tuple[tuple[str, Reader], ...]]] = {}


def _readers(cls: type[Message]) -> tuple[tuple[str, Reader], ...]:
    """Return a reader for each field of a message type; cached, as inspecting annotations is slower than reading."""
    if (plan := _PLANS.get(cls)) is None:
        plan = _PLANS[cls] = _plan(cls)
    return plan


def _plan(cls: type[Message]) -> tuple[tuple[str, Reader], ...]:
    hints = get_type_hints(cls)
    names = [item.name for item in fields(cls)]  # type: ignore[arg-type]  # every subclass is a dataclass; a test asserts it
    return tuple((name, _reader(name, hints[name])) for name in names)


def _resolved(kind: Any) -> Any:
    """Return what an alias of a `type` statement stands for, as NDArray is one from numpy 2.5 on; else the type."""
    alias = get_origin(kind) or kind
    if (value := getattr(alias, "__value__", None)) is None:
        return kind
    return _resolved(value[get_args(kind)] if get_args(kind) else value)


def _reader(name: str, kind: Any) -> Reader:
    kind = _resolved(kind)
    parts = [_resolved(part) for part in get_args(kind)] if _is_union(kind) else [kind]
    if NoneType in parts:
        (inner,) = (part for part in parts if part is not NoneType)
        return functools.partial(_read_optional, name, _reader(name, inner))
    if all(get_origin(part) is np.ndarray for part in parts):
        return functools.partial(_read_array, name, tuple(map(_dtype, parts)))
    if get_origin(kind) is tuple and get_origin(part := _resolved(get_args(kind)[0])) is np.ndarray:
        return functools.partial(_read_arrays, name, (_dtype(part),))
    return functools.partial(_read_scalar, name, kind)


def _is_union(kind: Any) -> bool:
    return isinstance(kind, UnionType) or get_origin(kind) is Union


def _dtype(kind: Any) -> np.dtype[Any]:
    found: np.dtype[Any] = np.dtype(get_args(get_args(kind)[1])[0])
    return found


def _read_array(
    name: str, wanted: tuple[np.dtype[Any], ...], scalars: dict[str, Any], arrays: dict[str, frame.Array]
) -> frame.Array:
    if name not in arrays:
        raise SchemaError(f"array {name} is missing.")
    return _array(name, wanted, arrays.pop(name))


def _read_arrays(
    name: str, wanted: tuple[np.dtype[Any], ...], scalars: dict[str, Any], arrays: dict[str, frame.Array]
) -> tuple[frame.Array, ...]:
    parts: list[frame.Array] = []
    while (key := f"{name}.{len(parts)}") in arrays:
        parts.append(_array(name, wanted, arrays.pop(key)))
    return tuple(parts)


def _read_optional(name: str, read: Reader, scalars: dict[str, Any], arrays: dict[str, frame.Array]) -> Any:
    return read(scalars, arrays) if name in scalars or name in arrays or f"{name}.0" in arrays else None


def _read_scalar(name: str, kind: Any, scalars: dict[str, Any], arrays: dict[str, frame.Array]) -> Any:
    if name not in scalars:
        raise SchemaError(f"field {name} is missing.")
    return _scalar(name, kind, scalars.pop(name))


def _array(name: str, wanted: tuple[np.dtype[Any], ...], value: frame.Array) -> frame.Array:
    if value.dtype not in wanted:
        raise SchemaError(f"array {name} is {value.dtype}, not {' or '.join(map(str, wanted))}.")
    return value


@functools.cache
def _origin(kind: Any) -> Any:
    return get_origin(kind)


def _scalar(name: str, kind: Any, value: Any) -> Any:
    if _origin(kind) is tuple:
        if not isinstance(value, list):
            raise SchemaError(f"field {name} is not a list.")
        return tuple(_scalar(name, get_args(kind)[0], part) for part in value)
    if _origin(kind) is dict:
        if not isinstance(value, dict) or len(value) > 4096:
            raise SchemaError(f"field {name} is not a map.")
        return value
    if kind is float and type(value) is int:
        value = float(value)
    if type(value) is not kind:
        raise SchemaError(f"field {name} is {type(value).__name__}, not {kind.__name__}.")
    if kind is int and not 0 <= value <= NO_LIMIT:
        raise SchemaError(f"field {name} is {value}, out of range.")
    if kind is float and not math.isfinite(value):
        raise SchemaError(f"field {name} is not finite.")
    return value
