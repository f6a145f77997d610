"""The choice of matrix products."""

import pytest
import torch

from learner.networks import product_choice


@pytest.fixture(autouse=True)
def _same_setting_afterwards():
    before = torch.get_float32_matmul_precision()
    yield
    torch.set_float32_matmul_precision(before)


def test_what_is_chosen_keeps_float32():
    """After the choice, products of the learner's shapes are as exact as float32 allows."""
    kept = product_choice.choose_products()
    assert torch.get_float32_matmul_precision() == ("medium" if kept else "highest")
    assert max(product_choice._error(*shape) for shape in product_choice.PROBES) < product_choice.TOLERANCE


def test_rounding_to_bfloat16_is_noticed(monkeypatch):
    """Where products come out rounded to bfloat16, the setting goes back to full precision."""
    exact = torch.bmm

    def rounded(a, b):
        return exact(a.bfloat16().to(a.dtype), b.bfloat16().to(b.dtype)) if a.dtype == torch.float32 else exact(a, b)

    monkeypatch.setattr(torch, "bmm", rounded)
    assert not product_choice.choose_products()
    assert torch.get_float32_matmul_precision() == "highest"
