"""Matrix products in pieces."""

import json
import subprocess
import sys

import numpy as np
import pytest
import torch

from eia_sec.learner.networks import compiled, matrix_products
from eia_sec.learner.networks.matrix_products import SMALL, WHOLE
from eia_sec.learner.off_policy.engine import Engine
from tests.learner.off_policy.test_engine import BASE, TEAM, batches
from tests.learner.off_policy.variants import variant

SHAPES = [(128, 66, 64), (512, 67, 128), (128, 437, 64), (130, 33, 7), (1, 1, 1), (7, 300, 256), (3, 5, 20_000)]
CASES = [
    (shape, piece) for shape in SHAPES for piece in (SMALL, WHOLE, 1000, 1) if piece >= SMALL or np.prod(shape) <= SMALL
]


def factors(shape, dtype):
    """Return [R, K], [K, C] and [R, C] of a shape R, K, C."""
    rows, inner, columns = shape
    draw = np.random.default_rng(0)
    sizes = (rows, inner), (inner, columns), (rows, columns)
    return [draw.normal(size=size).astype(dtype) for size in sizes]


def empty(*shape, dtype):
    """Return an array of what must not be left in a result, with more of it around."""
    return np.full((shape[0] + 2, *shape[1:]), np.nan, dtype)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("shape", "piece"), CASES, ids=str)
def test_products_in_pieces_are_products(shape, piece, dtype):
    """Each of the three is what NumPy makes of the same numbers, and nothing beside the result is written."""
    rows, inner, columns = shape
    a, b, c = factors(shape, dtype)
    error = {"rtol": 1e-9, "atol": 1e-9} if dtype is np.float64 else {"rtol": 1e-3, "atol": 1e-3}

    whole = empty(rows, columns, dtype=dtype)
    matrix_products.multiply(a, b, whole[1:-1], piece)
    np.testing.assert_allclose(whole[1:-1], a @ b, **error)
    transposed = empty(inner, columns, dtype=dtype)
    matrix_products.multiply_transposed(a, c, transposed[1:-1], piece)
    np.testing.assert_allclose(transposed[1:-1], a.T @ c, **error)
    by_transposed = empty(rows, inner, dtype=dtype)
    matrix_products.multiply_by_transposed(
        c, b, by_transposed[1:-1], np.full(inner * columns + 3, np.nan, dtype), piece
    )
    np.testing.assert_allclose(by_transposed[1:-1], c @ b.T, **error)

    for result in (whole, transposed, by_transposed):
        assert np.isnan(result[[0, -1]]).all()


@pytest.mark.parametrize("shape", [(8, 8), (64, 128), (13, 21), (1, 9)])
def test_a_turned_matrix_is_the_transposed_one(shape):
    """Squares and what is left beside them."""
    matrix = np.arange(shape[0] * shape[1], dtype=np.float32).reshape(shape)
    out = np.zeros(shape[::-1], np.float32)
    matrix_products.transpose(matrix, out)
    np.testing.assert_array_equal(out, matrix.T)


@pytest.mark.parametrize("features", [{"avx512f": True}, {"avx512f": False}, {}])
def test_pieces_are_for_processors_with_long_vectors(monkeypatch, features):
    """Elsewhere products are not cut."""
    monkeypatch.setattr(matrix_products.binding, "get_host_cpu_features", lambda: features)
    assert matrix_products.piece_size() == (SMALL if features.get("avx512f") else WHOLE)


@pytest.mark.parametrize("name", ["eia-sec", "maddpg", "matd3", "masac"])
def test_training_ends_where_whole_products_do(monkeypatch, name):
    """Twenty updates in pieces, of many sizes, end within rounding of twenty updates with whole products."""
    config, ends = variant(BASE, name), []
    for piece in (SMALL, 500, WHOLE):
        monkeypatch.setattr(compiled, "piece_size", lambda piece=piece: piece)
        engine = Engine(config, TEAM, 3, dtype=torch.float64, cores=1)
        for batch in batches(TEAM, config, 20):
            engine.update(batch)
        ends.append(engine.algorithm.actors.networks.flat.detach().clone())
    for end in ends[:-1]:
        torch.testing.assert_close(end, ends[-1], rtol=1e-9, atol=1e-9)


@pytest.mark.slow
def test_the_benchmark_reports_every_kind_of_product():
    """The command prints JSON with a speed for each product, cut and whole."""
    command = [sys.executable, "-m", "research.benchmarks.products", "--repeats", "2", "--widths", "16"]
    lines = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)["products"]
    assert {line["product"] for line in lines} == {"a b", "a^T b", "a b^T"}
    assert all(line["gflops"] > 0 and line["whole_gflops"] > 0 for line in lines)
