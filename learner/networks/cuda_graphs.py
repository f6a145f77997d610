"""Updates as CUDA graphs: each kind of update is captured once and then replayed with one call."""

import torch
from torch import Tensor

from learner.algorithms.base import Algorithm, Batch, Diagnostics


class Graphs:
    """The captured updates of one algorithm.

    A graph reads its batch and noise from buffers of its own, so that what is replayed never moves. Capturing changes
    nothing: the state is put back after the updates that warm up the device.

    Args:
        algorithm: the algorithm, on a CUDA device.
    """

    def __init__(self, algorithm: Algorithm) -> None:
        self._algorithm = algorithm
        self._batch: Batch | None = None
        self._noise: Tensor | None = None
        self._captured: dict[tuple[int, bool], tuple[torch.cuda.CUDAGraph, Diagnostics | None]] = {}

    def update(self, batch: Batch, noise: Tensor, phase: int, *, diagnostics: bool) -> Diagnostics | None:
        """Replay the update of this phase, capturing it first where it is new."""
        if self._batch is None or self._noise is None:
            self._batch, self._noise = Batch(*(t.clone() for t in batch)), noise.clone()
        for mine, given in zip(self._batch, batch, strict=True):
            mine.copy_(given)
        self._noise.copy_(noise)
        key = (phase, diagnostics)
        if key not in self._captured:
            self._captured[key] = self._capture(self._batch, self._noise, phase, diagnostics)
        graph, result = self._captured[key]
        graph.replay()
        return result

    def _capture(
        self, batch: Batch, noise: Tensor, phase: int, diagnostics: bool
    ) -> tuple[torch.cuda.CUDAGraph, Diagnostics | None]:
        state = self._algorithm.tensors()
        kept = {name: tensor.clone() for name, tensor in state.items()}
        side: torch.cuda.Stream = torch.cuda.Stream()  # type: ignore[no-untyped-call]  # torch leaves it untyped
        side.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side):
            for _ in range(3):
                self._algorithm.update(batch, noise, phase, diagnostics=diagnostics)
        torch.cuda.current_stream().wait_stream(side)
        graph = torch.cuda.CUDAGraph()
        # A thread may be reading tensors for a checkpoint meanwhile, which no capture of this one is to forbid.
        with torch.cuda.graph(graph, capture_error_mode="thread_local"):
            result = self._algorithm.update(batch, noise, phase, diagnostics=diagnostics)
        for name, tensor in state.items():
            tensor.copy_(kept[name])
        return graph, result
