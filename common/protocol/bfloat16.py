"""Numbers in bfloat16, for which numpy has no type: the high half of a float32's bits, as uint16.

They have a float32's range and 8 bits of precision.
"""

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.team import Float32

Bits = NDArray[np.uint16]

_HALF = np.uint32(16)
_BELOW_HALF = np.uint32(0x7FFF)
_NAN = np.uint16(0x7FC0)
_MAGNITUDE = np.uint16(0x7FFF)
_INFINITE = np.uint16(0x7F80)


def to_bits(values: Float32) -> Bits:
    """Return the nearest bfloat16 numbers, ties to even, as torch does.

    Args:
        values: float32 of any shape. Numbers beyond the range become infinite, and NaN stays NaN.
    """
    bits = np.ascontiguousarray(values).view(np.uint32)
    rounded = bits >> _HALF
    rounded &= np.uint32(1)
    rounded += _BELOW_HALF
    rounded += bits
    rounded >>= _HALF
    found = rounded.astype(np.uint16)
    if (undefined := np.isnan(values)).any():
        found[undefined] = _NAN
    return found


def from_bits(bits: Bits) -> Float32:
    """Return the same numbers as float32."""
    return (bits.astype(np.uint32) << _HALF).view(np.float32)


def are_finite(bits: Bits) -> bool:
    """Return whether all numbers are finite."""
    return bool((bits & _MAGNITUDE).max(initial=0) < _INFINITE)


def within(bits: Bits, largest: float) -> bool:
    """Return whether all numbers are finite and of at most this magnitude, itself rounded to bfloat16."""
    # Without their signs, larger numbers have larger bits; infinity and NaN have the largest.
    most = to_bits(np.array([largest], np.float32))[0]
    return bool((bits & _MAGNITUDE).max(initial=0) <= most)
