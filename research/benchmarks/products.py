"""Speed of the learner's matrix products, in pieces and whole.

    python -m research.benchmarks.products [--widths 64 128] [--repeats 200]

The products are those of a local critic (67 inputs) and of a joint one (437) for a batch of 128, and of a
member that four agents share, with hidden layers of the given widths: what goes forward (a b), the gradient by the
weights (a^T b) and the gradient through a layer (a b^T). Prints JSON; each speed is the best of many, and `limit` is
that of a large product (see `research.benchmarks.learner`).
"""

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterator
from typing import Any, Final

for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")

import numpy as np  # noqa: E402  (the variables above count only before numpy is loaded)
import torch  # noqa: E402  (as above)

from eia_sec.deploy.reports.provenance import provenance  # noqa: E402  (as above)
from eia_sec.learner.networks.matrix_products import (  # noqa: E402  (as above)
    WHOLE,
    Floats,
    multiply,
    multiply_by_transposed,
    multiply_transposed,
    piece_size,
)
from research.benchmarks.learner import fastest, matrix_speed  # noqa: E402  (as above)

ROWS: Final = (128, 512)
INPUTS: Final = (67, 437)
IN_A_ROW: Final = 10
"""Products that are timed together."""


def shapes(width: int) -> Iterator[tuple[int, int, int]]:
    """Return rows, inputs and outputs of the layers with so many units."""
    for rows in ROWS:
        yield rows, width, width
        yield rows, INPUTS[0], width
    yield ROWS[0], INPUTS[1], width


def kinds(shape: tuple[int, int, int]) -> dict[str, Callable[[int], None]]:
    """Return the products of a layer, each of which takes the size of a piece."""
    rows, inner, columns = shape
    draw = np.random.default_rng(0)
    a, b, c = (draw.normal(size=size).astype(np.float32) for size in ((rows, inner), (inner, columns), (rows, columns)))
    forward, weights, through, space = np.empty_like(c), np.empty_like(b), np.empty_like(a), np.empty(b.size, a.dtype)

    def repeated(product: Callable[..., None], *arrays: Floats) -> Callable[[int], None]:
        def work(piece: int) -> None:
            for _ in range(IN_A_ROW):
                product(*arrays, piece)

        return work

    found = {"a b": repeated(multiply, a, b, forward), "a^T b": repeated(multiply_transposed, a, c, weights)}
    if inner == columns:  # no gradient goes through a first layer
        found["a b^T"] = repeated(multiply_by_transposed, c, b, through, space)
    return found


def measured(widths: list[int], repeats: int) -> list[dict[str, Any]]:
    """Return one line for each product."""
    lines = []
    for shape in (shape for width in widths for shape in shapes(width)):
        operations = 2.0 * IN_A_ROW * float(np.prod(shape))
        for name, product in kinds(shape).items():
            product(WHOLE)
            speeds = [
                operations / fastest(lambda product=product, piece=piece: product(piece), repeats) / 1e9
                for piece in (piece_size(), WHOLE)
            ]
            line = {"product": name, "rows": shape[0], "inputs": shape[1], "outputs": shape[2]}
            lines.append({**line, "gflops": round(speeds[0], 1), "whole_gflops": round(speeds[1], 1)})
    return lines


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description="Speed of the learner's matrix products.")
    parser.add_argument("--widths", type=int, nargs="+", default=[64, 128])
    parser.add_argument("--repeats", type=int, default=200)
    options = parser.parse_args()
    torch.set_num_threads(1)
    found = {"limit_gflops": round(matrix_speed() / 1e9, 1), "in_pieces": piece_size() != WHOLE}
    lines = measured(options.widths, options.repeats)
    sys.stdout.write(json.dumps({**provenance("research.benchmarks.products"), **found, "products": lines}) + "\n")


if __name__ == "__main__":
    main()
