"""bfloat16 numbers as uint16: the same numbers as torch's, and bounds that nothing strange passes."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from eia_sec.common.protocol import bfloat16

ANY = st.lists(st.floats(width=32), max_size=20)
"""Any float32 numbers: subnormal ones, infinities and NaN too."""


@given(numbers=ANY)
def test_conversion_is_that_of_torch(numbers):
    """The bits are those of torch's conversion; numpy's way back gives what torch's does."""
    values = np.array(numbers, np.float32)
    wanted = torch.from_numpy(values).to(torch.bfloat16)
    found = bfloat16.to_bits(values)
    defined = ~np.isnan(values)
    np.testing.assert_array_equal(found[defined], wanted.view(torch.uint16).numpy()[defined])
    np.testing.assert_array_equal(bfloat16.from_bits(found), wanted.float().numpy())
    assert found.dtype == np.uint16


def test_halves_go_to_the_even_neighbour():
    """1 + 2^-8 lies between two numbers and becomes 1, 1 + 3 2^-8 becomes 1 + 2^-6; the step there is 2^-7."""
    found = bfloat16.from_bits(bfloat16.to_bits(np.array([1 + 2**-8, 1 + 3 * 2**-8, -1 - 2**-8], np.float32)))
    assert found.tolist() == [1.0, 1 + 2**-6, -1.0]


def test_nan_stays_nan_whatever_its_bits_are():
    """The largest bits of all would wrap around to zero."""
    odd = np.array([0x7FFFFFFF, 0xFFFFFFFF, 0x7F800001, 0xFF800001], np.uint32).view(np.float32)
    assert np.isnan(bfloat16.from_bits(bfloat16.to_bits(odd))).all()


def test_arrays_of_any_layout_are_converted():
    """A transposed view and a strided one hold the same numbers as their copies."""
    values = np.arange(24, dtype=np.float32).reshape(4, 6) / 7
    for view in (values.T, values[::2, 1::3]):
        np.testing.assert_array_equal(bfloat16.to_bits(view), bfloat16.to_bits(view.copy()))


@given(numbers=ANY, largest=st.floats(0.0, 2.0**100, width=32))
def test_bounds_are_those_of_the_numbers(numbers, largest):
    """A magnitude may be as large as the bound once that is rounded, too; neither infinities nor NaN pass."""
    values = np.array(numbers, np.float32)
    bits = bfloat16.to_bits(values)
    rounded, most = bfloat16.from_bits(bits), bfloat16.from_bits(bfloat16.to_bits(np.array([largest], np.float32)))[0]
    assert bfloat16.within(bits, largest) == bool((np.abs(rounded) <= most).all())
    assert bfloat16.are_finite(bits) == bool(np.isfinite(rounded).all())


@pytest.mark.parametrize("value", [np.inf, -np.inf, np.nan])
def test_nothing_infinite_passes_any_bound(value):
    """One such number among many is found."""
    bits = bfloat16.to_bits(np.array([0.0, -3.0, value, 1.0], np.float32))
    assert not bfloat16.within(bits, 1e38)
    assert not bfloat16.are_finite(bits)
