"""Spaces of a served environment, and their values, as msgpack carries them.

A space is a map with a `type`; a value's form follows from its space alone:

| type | further fields | a value |
|---|---|---|
| box | dtype, shape, low, high | the numbers' bytes, row-major, little-endian |
| discrete | n, start | whole number, at least start and below start + n |
| multi_discrete | nvec, start | list of whole numbers, each as that of a discrete |
| multi_binary | shape | one byte for each bit, 0 or 1, row-major |
| dict | spaces: list of [key, space] | map |
| tuple | spaces: list of spaces | list |

`low` and `high` of a box are one number for all, or bytes as a value's. Gymnasium's spaces are known by their names, so
that this module imports nothing of it.
"""

import math
from collections.abc import Callable, Mapping
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.errors import SchemaError

DTYPES: Final = ("<f2", "<f4", "<f8", "|i1", "|u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8", "|b1")
"""What a box may hold, in numpy's words."""
MOST_NUMBERS: Final = 2**24
"""Most numbers of one box."""
MOST_PARTS: Final = 4096
"""Most parts of one space that has parts, and most numbers of a multi_discrete."""
DEEPEST: Final = 4
"""Most levels of spaces within spaces."""
PART_BYTES: Final = 64
"""Bytes that msgpack adds to a value at most, without keys."""

Space = dict[str, Any]


class Form(Protocol):
    """How values of one space travel.

    Attributes:
        most: most bytes that a value takes.
    """

    most: int

    def pack(self, value: Any) -> Any:
        """Return what msgpack is to carry; raise ValueError or TypeError for a value that is not of the space."""

    def unpack(self, raw: Any) -> Any:
        """Return the value as Gymnasium has it; raise SchemaError for what is not of the space."""


def described(space: Any, depth: int = 0) -> Space:
    """Return a Gymnasium space as a map.

    Raises:
        SchemaError: it is of a type that does not travel, or too large.
    """
    name = next((kind.__name__ for kind in type(space).__mro__ if kind.__name__ in _DESCRIBED), "")
    if not name or depth > DEEPEST:
        raise SchemaError(f"a space of type {type(space).__name__} cannot be served; use {', '.join(_DESCRIBED)}.")
    found: Space = _DESCRIBED[name](space, depth)
    form_of(found)
    return found


def _box(space: Any, depth: int) -> Space:
    dtype = np.dtype(space.dtype).newbyteorder("<").str
    return {
        "type": "box",
        "dtype": dtype,
        "shape": [int(size) for size in space.shape],
        "low": _bound(space.low, dtype),
        "high": _bound(space.high, dtype),
    }


def _bound(values: Any, dtype: str) -> Any:
    array = np.asarray(values, dtype)
    if array.size and (array == array.flat[0]).all():
        return array.flat[0].item()
    return array.tobytes()


_DESCRIBED: Final[dict[str, Callable[[Any, int], Space]]] = {
    "Box": _box,
    "Discrete": lambda s, _: {"type": "discrete", "n": int(s.n), "start": int(getattr(s, "start", 0))},
    "MultiDiscrete": lambda s, _: {
        "type": "multi_discrete",
        "nvec": np.ravel(s.nvec).tolist(),
        "start": np.ravel(getattr(s, "start", np.zeros_like(s.nvec))).tolist(),
    },
    "MultiBinary": lambda s, _: {"type": "multi_binary", "shape": [int(size) for size in s.shape]},
    "Dict": lambda s, depth: {
        "type": "dict",
        "spaces": [[str(key), described(part, depth + 1)] for key, part in s.spaces.items()],
    },
    "Tuple": lambda s, depth: {"type": "tuple", "spaces": [described(part, depth + 1) for part in s.spaces]},
}


def form_of(space: Any, depth: int = 0) -> Form:
    """Return how values of a described space travel.

    Raises:
        SchemaError: the description has other fields, types or sizes than the table of this module allows.
    """
    if not isinstance(space, dict) or depth > DEEPEST:
        raise SchemaError("a space is no map, or lies too deep in others.")
    kind = space.get("type")
    if kind == "box":
        return Box(space)
    if kind == "discrete":
        return Discrete(_whole(space, "n", 1), _whole(space, "start", -(2**62)))
    if kind == "multi_discrete":
        nvec, start = _wholes(space, "nvec", 1), _wholes(space, "start", -(2**62))
        if len(start) != len(nvec):
            raise SchemaError("a multi_discrete space has other numbers of options and of starts.")
        return MultiDiscrete(nvec, start)
    if kind == "multi_binary":
        return MultiBinary(space)
    parts = space.get("spaces")
    if kind not in ("dict", "tuple") or not isinstance(parts, list) or len(parts) > MOST_PARTS:
        raise SchemaError(f"a space is of type {str(kind)[:40]!r}, or without its parts.")
    if kind == "tuple":
        return Tuple([form_of(part, depth + 1) for part in parts])
    for part in parts:
        if not (isinstance(part, list) and len(part) == 2 and isinstance(part[0], str)):
            raise SchemaError("a part of a dict space is no pair of a key and a space.")
    return Dict({key: form_of(part, depth + 1) for key, part in parts})


def _whole(space: Space, name: str, least: int) -> int:
    value = space.get(name)
    if type(value) is not int or not least <= value < 2**62:
        raise SchemaError(f"{name} of a {space['type']} space is no whole number in its range.")
    return value


def _wholes(space: Space, name: str, least: int) -> list[int]:
    values = space.get(name)
    if not isinstance(values, list) or not 0 < len(values) <= MOST_PARTS:
        raise SchemaError(f"{name} of a {space['type']} space is no list of 1 to {MOST_PARTS} whole numbers.")
    return [_whole({**space, name: value}, name, least) for value in values]


class Box:
    """Numbers of one dtype.

    Attributes:
        dtype, shape: of a value.
    """

    def __init__(self, space: Space) -> None:
        shape, dtype = space.get("shape"), space.get("dtype")
        if dtype not in DTYPES or not isinstance(shape, list) or len(shape) > 8:
            raise SchemaError(f"a box has the dtype {str(dtype)[:20]!r}, or no shape.")
        if not all(type(size) is int and 0 < size <= MOST_NUMBERS for size in shape) or math.prod(shape) > MOST_NUMBERS:
            raise SchemaError(f"a box has the shape {str(shape)[:80]}; at most {MOST_NUMBERS:,} numbers travel.")
        self.dtype, self.shape = np.dtype(str(dtype)), tuple(shape)
        self._bytes = math.prod(shape) * self.dtype.itemsize
        self.most = self._bytes + PART_BYTES
        self._ends = (space.get("low"), space.get("high"))
        for given in self._ends:
            if type(given) not in (int, float, bool) and not (isinstance(given, bytes) and len(given) == self._bytes):
                raise SchemaError("a bound of a box is neither a number nor the bytes of a value.")

    def bounds(self) -> tuple[NDArray[Any], NDArray[Any]]:
        """Return the least and the greatest value."""
        low, high = (self._bound(given) for given in self._ends)
        return low, high

    def _bound(self, given: Any) -> NDArray[Any]:
        if isinstance(given, bytes):
            return self.unpack(given)
        try:
            return np.full(self.shape, given, self.dtype)
        except (OverflowError, ValueError) as error:
            raise SchemaError(f"a bound of a box does not fit its dtype: {error}") from error

    def pack(self, value: Any) -> bytes:
        """Return the bytes; raise ValueError or TypeError for another shape."""
        array = np.asarray(value, self.dtype)
        if array.shape != self.shape:
            raise ValueError(f"an array of shape {list(array.shape)} in a space of shape {list(self.shape)}")
        return array.tobytes()

    def unpack(self, raw: Any) -> NDArray[Any]:
        """Return an array of its own; raise SchemaError for anything but the right number of bytes."""
        if not isinstance(raw, bytes) or len(raw) != self._bytes:
            raise SchemaError(f"a value of a box is not {self._bytes} bytes.")
        return np.frombuffer(raw, self.dtype).reshape(self.shape).copy()


class MultiBinary(Box):
    """Several bits."""

    def __init__(self, space: Space) -> None:
        super().__init__({**space, "dtype": "|i1", "low": 0, "high": 1})

    def pack(self, value: Any) -> bytes:
        """Return a byte for each bit; raise ValueError or TypeError for anything else."""
        if not np.isin(value, (0, 1)).all():
            raise ValueError("bits are 0 or 1")
        return super().pack(value)

    def unpack(self, raw: Any) -> NDArray[Any]:
        """Return an array of its own; raise SchemaError for anything but a byte of 0 or 1 for each bit."""
        bits = super().unpack(raw)
        if not np.isin(bits, (0, 1)).all():
            raise SchemaError("a value of a multi_binary space holds something else than 0 and 1.")
        return bits


class Discrete:
    """A choice."""

    def __init__(self, options: int, start: int) -> None:
        self._options = range(start, start + options)
        self.most = PART_BYTES

    def pack(self, value: Any) -> int:
        """Return the whole number; raise ValueError or TypeError for one that is no option."""
        if int(value) not in self._options:
            raise ValueError(f"{value} is none of {self._options}")
        return int(value)

    def unpack(self, raw: Any) -> int:
        """Return the whole number; raise SchemaError for anything but an option."""
        if type(raw) is not int or raw not in self._options:
            raise SchemaError("a value of a discrete space is none of its options.")
        return raw


class MultiDiscrete:
    """Several choices."""

    def __init__(self, options: list[int], start: list[int]) -> None:
        self._choices = [Discrete(*choice) for choice in zip(options, start, strict=True)]
        self.most = PART_BYTES + 9 * len(options)

    def pack(self, value: Any) -> list[int]:
        """Return the whole numbers; raise ValueError or TypeError for others than options."""
        return [choice.pack(number) for choice, number in zip(self._choices, np.ravel(value), strict=True)]

    def unpack(self, raw: Any) -> NDArray[np.int64]:
        """Return [choices] whole numbers; raise SchemaError for anything but an option of each choice."""
        if not isinstance(raw, list) or len(raw) != len(self._choices):
            raise SchemaError(f"a value of a multi_discrete space is no list of {len(self._choices)}.")
        return np.array([choice.unpack(number) for choice, number in zip(self._choices, raw, strict=True)], np.int64)


class Dict:
    """Several values by their keys."""

    def __init__(self, parts: Mapping[str, Form]) -> None:
        self._parts = parts
        self.most = PART_BYTES + sum(part.most + 4 * len(key) + 8 for key, part in parts.items())

    def pack(self, value: Any) -> dict[str, Any]:
        """Return the parts."""
        return {key: part.pack(value[key]) for key, part in self._parts.items()}

    def unpack(self, raw: Any) -> dict[str, Any]:
        """Return the parts; raise SchemaError unless they are those of the space."""
        if not isinstance(raw, dict) or raw.keys() != self._parts.keys():
            raise SchemaError("a value of a dict space has other keys than the space.")
        return {key: part.unpack(raw[key]) for key, part in self._parts.items()}


class Tuple:
    """Several values in order."""

    def __init__(self, parts: list[Form]) -> None:
        self._parts = parts
        self.most = PART_BYTES + sum(part.most for part in parts)

    def pack(self, value: Any) -> list[Any]:
        """Return the parts."""
        return [part.pack(each) for part, each in zip(self._parts, value, strict=True)]

    def unpack(self, raw: Any) -> tuple[Any, ...]:
        """Return the parts; raise SchemaError unless there are as many as in the space."""
        if not isinstance(raw, list) or len(raw) != len(self._parts):
            raise SchemaError("a value of a tuple space has another number of parts than the space.")
        return tuple(part.unpack(each) for part, each in zip(self._parts, raw, strict=True))
