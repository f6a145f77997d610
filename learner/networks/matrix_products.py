"""Matrix products of the compiled kernels: BLAS products, cut into pieces of the size at which BLAS is fastest.

OpenBLAS, which SciPy ships, reorders both factors before it multiplies them. That doubles the time of small products.
With AVX-512 it has kernels that skip the reordering, for products of up to a million multiplications whose
second factor, as we store it, is not transposed. So this module cuts larger products up, and transposes a factor itself
where BLAS would have to. On other processors products stay whole. `python -m research.benchmarks.products` measures the
gain.

The cuts depend on the shape and the processor alone, so the same run gives the same numbers.
"""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from llvmlite import binding
from numba import types
from numpy.typing import NDArray

from eia_sec.learner.networks.compilation import compiled

Floats = NDArray[Any]
"""Contiguous float32 or float64; all arrays of one call have the same type."""

SMALL: Final = 1_000_000
"""Largest product, in multiplications, for which OpenBLAS copies nothing."""
WHOLE: Final = 1 << 62
"""Size of a piece, in multiplications, that leaves every product whole."""
BLOCK: Final = 36_864
"""Bytes of the second factor in a piece. Every row of the result reads them, so they fit into the nearest cache."""
LANES: Final = 16
"""Numbers in the longest vector register."""
TILE: Final = 8
"""Side of the squares in which a matrix is transposed."""

# The function that np.dot compiles to. Numba's own library has it under this name, so compiled code on disk finds it
# again. Its arguments are those of a column-major BLAS: letters for the type and for transposed factors, sizes, and
# addresses with leading dimensions.
_gemm: Callable[..., int] = types.ExternalFunction(
    "numba_xxgemm",
    types.int32(
        *[types.int8] * 3,
        *[types.intp] * 3,
        *[types.uintp] * 2,
        types.intp,
        types.uintp,
        types.intp,
        *[types.uintp] * 2,
        types.intp,
    ),
)
_SINGLE, _DOUBLE, _PLAIN, _TRANSPOSED = (ord(letter) for letter in "sdnt")
# Global, because an array made in a kernel may be freed after the last use of its name, before BLAS reads it.
_SINGLE_UNITS, _DOUBLE_UNITS = np.array([0.0, 1.0], np.float32), np.array([0.0, 1.0], np.float64)


def piece_size() -> int:
    """Return how many multiplications a piece of a product may have on this machine's processor."""
    return SMALL if binding.get_host_cpu_features().get("avx512f", False) else WHOLE


@compiled
def multiply(a: Floats, b: Floats, out: Floats, piece: int) -> None:
    """Write a b.

    Args:
        a: [R, K].
        b: [K, C].
        out: [R, C].
        piece: see `piece_size`.
    """
    _in_pieces(a, b, out, _PLAIN, a.shape[1], 1, piece)


@compiled
def multiply_transposed(a: Floats, b: Floats, out: Floats, piece: int) -> None:
    """Write a^T b.

    Args:
        a: [R, K].
        b: [R, C].
        out: [K, C].
        piece: see `piece_size`.
    """
    _in_pieces(a, b, out, _TRANSPOSED, 1, a.shape[1], piece)


@compiled
def multiply_by_transposed(a: Floats, b: Floats, out: Floats, space: Floats, piece: int) -> None:
    """Write a b^T.

    Args:
        a: [R, C].
        b: [K, C].
        out: [R, K].
        space: at least [K C], overwritten.
        piece: see `piece_size`.
    """
    if piece == WHOLE:
        np.dot(a, b.T, out)
        return
    transposed = space[: b.size].reshape((b.shape[1], b.shape[0]))
    transpose(b, transposed)
    multiply(a, transposed, out, piece)


@compiled
def transpose(matrix: Floats, out: Floats) -> None:
    """Write a matrix [R, C] transposed, [C, R], square by square, so that a square's lines stay in the cache."""
    rows, columns = matrix.shape
    source, place = matrix.reshape(rows * columns), out.reshape(rows * columns)
    whole_rows, whole_columns = rows - rows % TILE, columns - columns % TILE
    for r in range(0, whole_rows, TILE):
        for c in range(0, whole_columns, TILE):
            for j in range(TILE):
                for i in range(TILE):
                    # Unsigned, because the compiler does not vectorise a loop whose index could be negative.
                    place[np.uint64((c + j) * rows + r + i)] = source[np.uint64((r + i) * columns + c + j)]
    out[whole_columns:] = matrix[:, whole_columns:].T
    out[:, whole_rows:] = matrix[whole_rows:].T


@compiled
def _in_pieces(a: Floats, b: Floats, out: Floats, letter: int, step: int, term: int, piece: int) -> None:
    """Write a product piece by piece; its sums have as many terms as b has rows.

    Args:
        a: the first factor, plain or to be transposed.
        b: [terms, C].
        out: [lines, C].
        letter: how BLAS is to take `a`.
        step: distance in `a` from a line of the result to the next.
        term: distance in `a` from a term of a sum to the next.
        piece: multiplications of a piece.
    """
    lines, terms, columns, size = out.shape[0], b.shape[0], b.shape[1], a.itemsize
    kind, zero, one = _constants(size)
    deep = terms if piece == WHOLE else _share(terms, BLOCK // (columns * size))
    tall = _share(lines, piece // (deep * columns))
    for t in range(0, terms, deep):
        beta = one if t > 0 else zero
        right = b.ctypes.data + t * columns * size
        for n in range(0, lines, tall):
            left = a.ctypes.data + (n * step + t * term) * size
            result = out.ctypes.data + n * columns * size
            sizes = columns, min(tall, lines - n), min(deep, terms - t)
            _gemm(kind, _PLAIN, letter, *sizes, one, right, columns, left, a.shape[1], beta, result, columns)


@compiled
def _share(whole: int, most: int) -> int:
    """Return the size of the fewest even parts that are at most `most`; a multiple of LANES if that fits."""
    parts = (whole + max(1, most) - 1) // max(1, most)
    even = (whole + parts - 1) // parts
    lanes = (even + LANES - 1) // LANES * LANES
    return lanes if lanes <= most else even


@compiled
def _constants(size: int) -> tuple[int, int, int]:
    """Return BLAS's letter for the type of this size in bytes, and the addresses of its 0 and 1."""
    if size == _SINGLE_UNITS.itemsize:
        start = _SINGLE_UNITS.ctypes.data
        return _SINGLE, start, start + size
    start = _DOUBLE_UNITS.ctypes.data
    return _DOUBLE, start, start + size
