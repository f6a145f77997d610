"""How a message type becomes a frame and comes back; the types themselves are declared in `common.messages`.

A message's scalar fields go into the frame's header, its arrays into the body, by name. Decoding checks every type
against the dataclass, so a message that exists is a message that fits its declaration.
"""

import math
from dataclasses import fields
from typing import Any, ClassVar, Self, get_args, get_origin, get_type_hints

import numpy as np

from common import frame
from common.errors import SchemaError


class Message:
    """Base of all messages: a frozen dataclass with a KIND that encodes and decodes itself."""

    KIND: ClassVar[int] = 0

    def encode(self) -> bytes:
        """Return the message's frame."""
        scalars: dict[str, Any] = {}
        arrays: dict[str, frame.Array] = {}
        for item in fields(self):  # type: ignore[arg-type]  # every subclass is a dataclass; a test asserts it
            value = getattr(self, item.name)
            if isinstance(value, np.ndarray):
                arrays[item.name] = value
            elif isinstance(value, tuple) and value and isinstance(value[0], np.ndarray):
                arrays.update({f"{item.name}.{index}": part for index, part in enumerate(value)})
            else:
                scalars[item.name] = value
        return frame.encode(self.KIND, scalars, arrays)

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Rebuild a message from its frame.

        Raises:
            FrameError, VersionError: when the bytes are not such a frame.
            SchemaError: when a field is missing, unknown or of another type.
        """
        scalars, arrays = frame.decode(data, cls.KIND)
        values: dict[str, Any] = {}
        hints = get_type_hints(cls)
        for item in fields(cls):  # type: ignore[arg-type]  # every subclass is a dataclass; a test asserts it
            values[item.name] = _take(item.name, hints[item.name], scalars, arrays)
        if scalars or arrays:
            raise SchemaError(f"{cls.__name__} has no field {sorted([*scalars, *arrays])[0][:40]!r}.")
        return cls(**values)


def _take(name: str, kind: Any, scalars: dict[str, Any], arrays: dict[str, frame.Array]) -> Any:
    if get_origin(kind) is np.ndarray:
        if name not in arrays:
            raise SchemaError(f"array {name} is missing.")
        return _array(name, kind, arrays.pop(name))
    if get_origin(kind) is tuple and get_origin(get_args(kind)[0]) is np.ndarray:
        parts: list[frame.Array] = []
        while f"{name}.{len(parts)}" in arrays:
            parts.append(_array(name, get_args(kind)[0], arrays.pop(f"{name}.{len(parts)}")))
        return tuple(parts)
    if name not in scalars:
        raise SchemaError(f"field {name} is missing.")
    return _scalar(name, kind, scalars.pop(name))


def _array(name: str, kind: Any, value: frame.Array) -> frame.Array:
    wanted = np.dtype(get_args(get_args(kind)[1])[0])
    if value.dtype != wanted:
        raise SchemaError(f"array {name} is {value.dtype}, not {wanted}.")
    return value


def _scalar(name: str, kind: Any, value: Any) -> Any:
    if get_origin(kind) is tuple:
        if not isinstance(value, list):
            raise SchemaError(f"field {name} is not a list.")
        return tuple(_scalar(name, get_args(kind)[0], part) for part in value)
    if get_origin(kind) is dict:
        if not isinstance(value, dict) or len(value) > 4096:
            raise SchemaError(f"field {name} is not a map.")
        return value
    if kind is float and type(value) is int:
        value = float(value)
    if type(value) is not kind:
        raise SchemaError(f"field {name} is {type(value).__name__}, not {kind.__name__}.")
    if kind is int and not 0 <= value < 2**63:
        raise SchemaError(f"field {name} is {value}, out of range.")
    if kind is float and not math.isfinite(value):
        raise SchemaError(f"field {name} is not finite.")
    return value
