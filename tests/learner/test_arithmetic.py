"""The choice of matrix products."""

import pytest
import torch

from learner import arithmetic


@pytest.fixture(autouse=True)
def _same_setting_afterwards():
    before = torch.get_float32_matmul_precision()
    yield
    torch.set_float32_matmul_precision(before)


def test_what_is_chosen_keeps_float32():
    """After the choice, products of the learner's shapes are as exact as float32 allows."""
    kept = arithmetic.choose_products()
    assert torch.get_float32_matmul_precision() == ("medium" if kept else "highest")
    assert max(arithmetic._error(*shape) for shape in arithmetic.PROBES) < arithmetic.TOLERANCE


def test_rounding_to_bfloat16_is_noticed(monkeypatch):
    """Where products come out rounded to bfloat16, the setting goes back to full precision."""
    exact = torch.bmm

    def rounded(a, b):
        return exact(a.bfloat16().to(a.dtype), b.bfloat16().to(b.dtype)) if a.dtype == torch.float32 else exact(a, b)

    monkeypatch.setattr(torch, "bmm", rounded)
    assert not arithmetic.choose_products()
    assert torch.get_float32_matmul_precision() == "highest"
