"""Captures work on a GPU as a CUDA graph, which is replayed with one call."""

from collections.abc import Callable, Iterable
from functools import cache
from typing import TypeVar

import torch
from torch import Tensor

Result = TypeVar("Result")
WARM_UPS = 3
"""Calls before a capture, in which libraries take their memory."""


def capture(work: Callable[[], Result], state: Iterable[Tensor]) -> tuple[torch.cuda.CUDAGraph, Result]:
    """Capture what `work` computes on the device.

    Args:
        work: reads tensors whose addresses stay as they are, and may change those of `state`.
        state: what `work` may change, on one device; the calls that warm up leave it as it was.

    Returns:
        The graph, and the result of `work`, whose tensors each replay overwrites.
    """
    kept = [(tensor.detach(), tensor.detach().clone()) for tensor in state]
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.device(device := kept[0][0].device):
        side = _stream(device)
        side.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side):
            for _ in range(WARM_UPS):
                work()
        torch.cuda.current_stream().wait_stream(side)
        # Another thread may be reading tensors for a checkpoint, which this capture must not forbid.
        with torch.cuda.graph(graph, stream=side, capture_error_mode="thread_local"):
            result = work()
    for tensor, before in kept:
        tensor.copy_(before)
    return graph, result


@cache
def _stream(device: torch.device) -> torch.cuda.Stream:
    """Return the stream on which this device's work is captured; libraries keep memory for every stream they saw."""
    return torch.cuda.Stream(device)
