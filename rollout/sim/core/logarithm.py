"""A natural logarithm that the compiler can vectorise, unlike the C library's."""

import math
from collections.abc import Callable
from typing import Any, Final, cast

import numpy as np
from numba.core import types
from numba.extending import intrinsic

from eia_sec.rollout.sim.core.compile import allocation_free

MANTISSA: Final = 52
"""Bits of a float64's fraction."""
LEAST: Final = int(np.float64(math.sqrt(0.5)).view(np.int64))
"""Bits of the least mantissa, sqrt(1/2)."""
MAGIC: Final = 2.0**52
"""OR-ing an integer below 2^52 into this number's bits gives the bits of their sum."""
MAGIC_BITS: Final = int(np.float64(MAGIC).view(np.int64))
LOG_2: Final = math.log(2.0)


def _reinterpreted(source: Any, target: Any) -> Any:
    """Return a function that reinterprets the bits of one type as another."""

    def typing_of(typing: Any, number: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            return builder.bitcast(arguments[0], context.get_value_type(target))

        return target(source), generate

    return intrinsic(typing_of)


_bits: Final = cast(Callable[[float], int], _reinterpreted(types.float64, types.int64))
_number: Final = cast(Callable[[int], float], _reinterpreted(types.int64, types.float64))


@allocation_free
def vectorisable_log(x: float) -> float:
    """Return ln x for finite x >= 1, to within 1e-13 (1 + ln x).

    x = 2^k m with m from sqrt(1/2) to sqrt(2); ln m = 2 artanh z with z = (m - 1) / (m + 1), by its series.
    """
    beyond = _bits(x) - LEAST
    power = beyond >> MANTISSA
    m = _number(_bits(x) - (beyond & -(1 << MANTISSA)))
    z = (m - 1.0) / (m + 1.0)
    w = z * z
    series = 1.0 / 9.0 + w * (1.0 / 11.0 + w * (1.0 / 13.0 + w * (1.0 / 15.0 + w * (1.0 / 17.0))))
    series = 1.0 + w * (1.0 / 3.0 + w * (1.0 / 5.0 + w * (1.0 / 7.0 + w * series)))
    return (_number(power | MAGIC_BITS) - MAGIC) * LOG_2 + 2.0 * z * series
