"""The one byte layout of everything on the wire.

    magic 4s | protocol u8 | kind u8 | reserved u16 | header bytes u32 | body bytes u64 | checksum u32
    header: msgpack {"fields": {...}, "arrays": [[name, dtype, [shape]], ...]}
    body:   the arrays, row-major, one after another, without padding

The checksum is the low half of the XXH3-64 of header and body, which takes a tenth of the time of zlib's CRC-32.

Decoding checks a frame completely, sizes first, before it allocates memory for the declared arrays.
"""

import math
import struct
from collections.abc import Mapping
from typing import Any, Final

import msgpack
import numpy as np
from numpy.typing import NDArray

from eia_sec.common.errors import FrameError, SchemaError, VersionError

PROTOCOL: Final = 5
"""Version of the protocol; every key contains it."""
MAX_FRAME: Final = 256 * 1024 * 1024
"""Largest frame that is decoded, bytes."""
MAX_HEADER: Final = 4 * 1024 * 1024
"""Largest msgpack header, bytes."""

_PREFIX: Final = struct.Struct("<4sBBHIQI")
_MAGIC: Final = b"EIAS"
_LOW: Final = 2**32 - 1
_DTYPES: Final = {"<f4": 4, "<f8": 8, "|u1": 1, "<u2": 2, "<i4": 4, "<i8": 8}

Array = NDArray[Any]
Data = bytes | memoryview
"""Received bytes, or a view of a part of them."""


def encode(kind: int, fields: Mapping[str, Any], arrays: Mapping[str, Array]) -> bytes:
    """Return the frame of one message.

    Args:
        kind: the message type's number, 0..255.
        fields: msgpack-able values.
        arrays: float32, float64, uint8, uint16, int32 or int64 arrays of any shape.

    Raises:
        SchemaError: when an array has any other dtype.
    """
    listing, parts = [], []
    for name, array in arrays.items():
        if array.dtype.str not in _DTYPES:
            raise SchemaError(f"array {name} has dtype {array.dtype}, which the protocol does not carry.")
        listing.append([name, array.dtype.str, list(array.shape)])
        parts.append(np.ascontiguousarray(array).data.cast("B") if array.size else b"")
    header = msgpack.packb({"fields": dict(fields), "arrays": listing})
    body = sum(len(part) for part in parts)
    return b"".join(
        (_PREFIX.pack(_MAGIC, PROTOCOL, kind, 0, len(header), body, checksum(header, *parts)), header, *parts)
    )


def checksum(*parts: Data) -> int:
    """Return the checksum of the parts' concatenation."""
    import xxhash  # noqa: PLC0415  # a robot that serves an environment does without it, and reads these limits

    state = xxhash.xxh3_64()
    for part in parts:
        state.update(part)
    return state.intdigest() & _LOW


def length(data: Data) -> int:
    """Return the length in bytes that the prefix of the first frame in `data` states.

    Raises:
        FrameError: when `data` does not begin with a frame, or holds only a part of it.
    """
    if len(data) < _PREFIX.size:
        raise FrameError(f"{len(data)} bytes are too few for a frame.")
    magic, _, _, _, header_size, body_size, _ = _PREFIX.unpack_from(data)
    if magic != _MAGIC or _PREFIX.size + header_size + body_size > len(data):
        raise FrameError("the bytes do not begin with a whole frame.")
    return int(_PREFIX.size + header_size + body_size)


def decode(data: Data, kind: int, most_header: int = MAX_HEADER) -> tuple[dict[str, Any], dict[str, Array]]:
    """Return the fields and arrays of a frame; the arrays are read-only views of the data.

    Args:
        data: the frame.
        kind: the kind that it must have.
        most_header: longest header of that kind, bytes; unpacked, a header takes many times its size in memory.

    Raises:
        FrameError: when the bytes are not a whole frame of this kind.
        VersionError: when the frame has another protocol version.
        SchemaError: when the header lists arrays that the body does not hold.
    """
    if not _PREFIX.size <= len(data) <= MAX_FRAME:
        raise FrameError(f"a frame cannot have {len(data)} bytes.")
    magic, protocol, found, reserved, header_size, body_size, stated = _PREFIX.unpack_from(data)
    if magic != _MAGIC:
        raise FrameError("the bytes do not begin with a frame.")
    if protocol != PROTOCOL:
        raise VersionError(f"the frame has protocol version {protocol}, this process {PROTOCOL}.")
    if found != kind or reserved != 0:
        raise FrameError(f"the frame is of kind {found}, not {kind}.")
    if header_size > most_header or _PREFIX.size + header_size + body_size != len(data):
        raise FrameError("the frame's length differs from what its prefix states.")
    view = memoryview(data)
    if checksum(view[_PREFIX.size :]) != stated:
        raise FrameError("the frame's checksum does not match its content.")
    fields, listing = _header(data[_PREFIX.size : _PREFIX.size + header_size])
    return fields, _arrays(data, listing, _PREFIX.size + header_size, body_size)


def _header(data: Data) -> tuple[dict[str, Any], list[Any]]:
    try:
        header = msgpack.unpackb(data, strict_map_key=True)
        fields, listing = header["fields"], header["arrays"]
    except (ValueError, KeyError, TypeError, msgpack.exceptions.UnpackException, RecursionError) as error:
        raise FrameError(f"the frame's header cannot be read: {error}") from error
    if not isinstance(fields, dict) or not isinstance(listing, list) or len(listing) > 4096:
        raise FrameError("the frame's header does not hold fields and a list of arrays.")
    if not all(isinstance(name, str) for name in fields):
        raise FrameError("a field's name in the frame's header is not a string.")
    return fields, listing


def _arrays(data: Data, listing: list[Any], start: int, size: int) -> dict[str, Array]:
    arrays: dict[str, Array] = {}
    end = start + size
    for entry in listing:
        if not (isinstance(entry, list) and len(entry) == 3 and isinstance(entry[0], str)):
            raise SchemaError("an array's description is malformed.")
        name, dtype, shape = entry
        if not isinstance(dtype, str) or dtype not in _DTYPES or not _is_shape(shape) or name in arrays:
            raise SchemaError(f"array {name[:40]!r} is described as {str(dtype)[:20]}{str(shape)[:40]}.")
        count = math.prod(shape)
        if start + count * _DTYPES[dtype] > end:
            raise SchemaError(f"array {name[:40]!r} reaches beyond the frame.")
        arrays[name] = np.frombuffer(data, dtype=dtype, count=count, offset=start).reshape(shape)
        start += count * _DTYPES[dtype]
    if start != end:
        raise SchemaError("the frame holds bytes that no array claims.")
    return arrays


def _is_shape(shape: Any) -> bool:
    if not isinstance(shape, list) or len(shape) > 8:
        return False
    product = 1
    for size in shape:
        if type(size) is not int or not 0 <= size < 2**31:
            return False
        # A zero counts as one: otherwise it would hide absurd sizes in the other dimensions.
        product *= size or 1
    return product < 2**40
