"""The fastest matrix products that still keep float32."""

import torch

PROBES = ((2, 512, 65, 64), (4, 128, 39, 64), (4, 64, 128, 65), (4, 1, 65, 128), (4, 128, 64, 2))
"""Shapes (products, rows, inner, columns) of the kinds that an update round multiplies."""
TOLERANCE = 1e-6
"""Largest error of a product relative to the sum of its terms' absolute values; bfloat16 has about 1e-3."""


def choose_products() -> bool:
    """Let torch multiply float32 matrices on the CPU by oneDNN where that keeps float32's precision.

    Precision "medium" allows oneDNN, which uses the processor's widest vectors where MKL does not, but it also allows
    it to round to bfloat16 on processors with matrix tiles. So the setting is kept only if products of the learner's
    shapes come out as exact as float32.

    Returns:
        Whether the setting was kept.
    """
    torch.set_float32_matmul_precision("medium")
    kept = all(_error(*shape) <= TOLERANCE for shape in PROBES)
    if not kept:
        torch.set_float32_matmul_precision("highest")
    return kept


def _error(products: int, rows: int, inner: int, columns: int) -> float:
    generator = torch.Generator().manual_seed(0)
    a = torch.randn(products, rows, inner, generator=generator)
    b = torch.randn(products, inner, columns, generator=generator)
    exact = torch.bmm(a.double(), b.double())
    scale = torch.bmm(a.double().abs(), b.double().abs())
    transposed = torch.bmm(
        a.transpose(1, 2).contiguous().transpose(1, 2), b.transpose(1, 2).contiguous().transpose(1, 2)
    )
    errors = [((product.double() - exact).abs() / scale).max() for product in (torch.bmm(a, b), transposed)]
    return float(max(errors))
