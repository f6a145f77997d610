"""Frames carry fields and arrays unchanged, and anything else is refused with a typed error."""

import struct

import msgpack
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from eia_sec.common.errors import FrameError, ProtocolError, SchemaError, VersionError
from eia_sec.common.protocol import frame

FIELDS = {"a": 1, "b": [1.5, "x"]}
ARRAYS = {"x": np.arange(12, dtype=np.float32).reshape(3, 4), "y": np.zeros((0, 5), np.int64), "z": np.uint8([1, 2])}


def whole() -> bytes:
    return frame.encode(7, FIELDS, ARRAYS)


def forged(header: object, body: bytes = b"") -> bytes:
    packed = msgpack.packb(header)
    return (
        struct.pack("<4sBBHIQI", b"EIAS", frame.PROTOCOL, 7, 0, len(packed), len(body), frame.checksum(packed, body))
        + packed
        + body
    )


def test_round_trip() -> None:
    """Fields and arrays come back equal, with dtype and shape."""
    fields, arrays = frame.decode(whole(), 7)
    assert fields == FIELDS
    assert list(arrays) == list(ARRAYS)
    for name, array in ARRAYS.items():
        assert arrays[name].dtype == array.dtype
        np.testing.assert_array_equal(arrays[name], array)


def test_arrays_do_not_alias_writable_memory() -> None:
    """Decoded arrays are read-only views, so a receiver cannot change a frame by accident."""
    _, arrays = frame.decode(whole(), 7)
    with pytest.raises(ValueError, match="read-only"):
        arrays["x"][0, 0] = 1.0


@pytest.mark.parametrize("cut", [0, 1, 23, 24, 30, -1])
def test_cut_frames_are_refused(cut: int) -> None:
    """A frame that ends anywhere too early is a FrameError."""
    with pytest.raises(FrameError):
        frame.decode(whole()[:cut], 7)


def test_every_flipped_bit_is_noticed() -> None:
    """No single bit can change without an error."""
    data = whole()
    for position in range(len(data) * 8):
        flipped = bytearray(data)
        flipped[position // 8] ^= 1 << position % 8
        with pytest.raises(ProtocolError):
            frame.decode(bytes(flipped), 7)


def test_other_kind_and_other_version_are_refused() -> None:
    """A frame of another kind is a FrameError, one of another protocol a VersionError."""
    with pytest.raises(FrameError, match="kind 7"):
        frame.decode(whole(), 8)
    newer = bytearray(whole())
    newer[4] += 1
    with pytest.raises(VersionError):
        frame.decode(bytes(newer), 7)


@pytest.mark.parametrize(
    "listing",
    [
        [["x", "<f4", [1 << 39, 1 << 39]]],
        [["x", "<f4", [-1]]],
        [["x", "<f4", [2]]],
        [["x", "|O", [1]]],
        [["x", "<f4", "1"]],
        [["x", "<f4", [0]], ["x", "<f4", [0]]],
        [["x", "<f4", [1.0]]],
        [["x", "<f4", [2**30, 2**30, 0]]],
        [["x", "<f4", [2**39, 2**39, 0]]],
        ["x"],
    ],
)
def test_arrays_that_the_body_cannot_hold_are_refused(listing: list[object]) -> None:
    """Sizes are checked before memory is taken, dtypes against the list of those that travel."""
    with pytest.raises(SchemaError):
        frame.decode(forged({"fields": {}, "arrays": listing}, b"1234"), 7)


@pytest.mark.parametrize(
    "header",
    [
        1,
        [],
        {"fields": 1, "arrays": []},
        {"fields": {}},
        {"fields": {}, "arrays": 1},
        {"fields": {b"a": 1}, "arrays": []},
    ],
)
def test_headers_that_are_none_are_refused(header: object) -> None:
    """A header of another structure is a FrameError."""
    with pytest.raises(FrameError):
        frame.decode(forged(header), 7)


def test_object_arrays_do_not_travel() -> None:
    """Encoding an array of Python objects is a SchemaError."""
    with pytest.raises(SchemaError):
        frame.encode(7, {}, {"x": np.array([object()])})


@settings(max_examples=300, deadline=None)
@given(st.binary(max_size=300))
def test_random_bytes_raise_typed_errors_only(data: bytes) -> None:
    """Whatever bytes come in, nothing but ProtocolError comes out."""
    for candidate in (data, whole()[: len(data)] + data, forged(0)[:24] + data):
        with pytest.raises(ProtocolError):
            frame.decode(candidate, 7)
