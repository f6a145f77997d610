"""Arrays of rows as tensors and back, in the same memory. numpy has no bfloat16; such numbers are uint16 there."""

from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor


def as_tensor(array: NDArray[Any]) -> Tensor:
    """Return an array as a tensor; numbers of type uint16 are bfloat16 numbers."""
    tensor = torch.from_numpy(array)
    return tensor.view(torch.bfloat16) if tensor.dtype == torch.uint16 else tensor


def as_array(tensor: Tensor) -> NDArray[Any]:
    """Return a tensor on the CPU as an array; bfloat16 numbers have type uint16."""
    array: NDArray[Any] = (tensor.view(torch.uint16) if tensor.dtype == torch.bfloat16 else tensor).numpy()
    return array
