"""Spaces of a served environment, and their values, as msgpack carries them.

A space is a map with a `type`; a value's form follows from its space alone:

| type | further fields | a value |
|---|---|---|
| box | dtype, shape, low, high | the numbers' bytes, row-major, little-endian |
| discrete | n, start | whole number |
| multi_discrete | nvec, start | list of whole numbers |
| multi_binary | shape | one byte for each bit, row-major |
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
        _whole(space, "n", 1)
        return Discrete(_whole(space, "start", -(2**62)))
    if kind == "multi_discrete":
        _wholes(space, "nvec", 1)
        if len(_wholes(space, "start", -(2**62))) != len(space["nvec"]):
            raise SchemaError("a multi_discrete space has other numbers of options and of starts.")
        return MultiDiscrete(len(space["nvec"]))
    if kind == "multi_binary":
        return Box({**space, "dtype": "|i1", "low": 0, "high": 1})
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


class Discrete:
    """A choice."""

    def __init__(self, start: int) -> None:
        self.most = PART_BYTES

    def pack(self, value: Any) -> int:
        """Return the whole number."""
        return int(value)

    def unpack(self, raw: Any) -> int:
        """Return the whole number; raise SchemaError for anything else."""
        if type(raw) is not int or not -(2**63) <= raw < 2**63:
            raise SchemaError("a value of a discrete space is no whole number.")
        return raw


class MultiDiscrete:
    """Several choices."""

    def __init__(self, size: int) -> None:
        self._size = size
        self.most = PART_BYTES + 9 * size

    def pack(self, value: Any) -> list[int]:
        """Return the whole numbers."""
        numbers = [int(number) for number in np.ravel(value)]
        if len(numbers) != self._size:
            raise ValueError(f"{len(numbers)} choices in a space of {self._size}")
        return numbers

    def unpack(self, raw: Any) -> NDArray[np.int64]:
        """Return [size] whole numbers; raise SchemaError for anything else."""
        if not isinstance(raw, list) or len(raw) != self._size:
            raise SchemaError(f"a value of a multi_discrete space is no list of {self._size}.")
        if not all(type(number) is int and -(2**63) <= number < 2**63 for number in raw):
            raise SchemaError("a value of a multi_discrete space holds something else than whole numbers.")
        return np.array(raw, np.int64)


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
