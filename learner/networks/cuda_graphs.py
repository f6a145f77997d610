"""Updates as CUDA graphs: each kind of update is captured once and then replayed with one call."""

from collections.abc import Callable, Iterable
from functools import cache
from typing import Any, TypeVar

import torch
from torch import Tensor

from eia_sec.learner.off_policy.algorithm import Algorithm, Batch, Diagnostics

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
    return torch.cuda.Stream(device)  # type: ignore[no-untyped-call]  # torch leaves it untyped


class Graphs:
    """The captured updates of one algorithm.

    A graph reads its batch and noise from buffers of its own, because a captured address must not move.

    Args:
        algorithm: the algorithm, on a CUDA device.
    """

    def __init__(self, algorithm: Algorithm[Any]) -> None:
        self._algorithm = algorithm
        self._batch: Batch | None = None
        self._noise: Tensor | None = None
        self._captured: dict[tuple[bool, bool], tuple[torch.cuda.CUDAGraph, Diagnostics | None]] = {}

    def update(self, batch: Batch, noise: Tensor, *, actor_step: bool, diagnostics: bool) -> Diagnostics | None:
        """Replay the update of this kind, after capturing it if it is new; see `Algorithm.update`."""
        if self._batch is None or self._noise is None:
            self._batch, self._noise = Batch(*(t.clone() for t in batch)), noise.clone()
        for mine, given in zip(self._batch, batch, strict=True):
            mine.copy_(given)
        self._noise.copy_(noise)
        kind = (actor_step, diagnostics)
        if kind not in self._captured:
            self._captured[kind] = self._capture(self._batch, self._noise, actor_step, diagnostics)
        graph, result = self._captured[kind]
        graph.replay()
        return result

    def _capture(
        self, batch: Batch, noise: Tensor, actor_step: bool, diagnostics: bool
    ) -> tuple[torch.cuda.CUDAGraph, Diagnostics | None]:
        def update() -> Diagnostics | None:
            return self._algorithm.update(batch, noise, actor_step=actor_step, diagnostics=diagnostics)

        return capture(update, self._algorithm.tensors().values())
