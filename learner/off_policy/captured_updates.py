"""Updates off policy as CUDA graphs: each kind of update is captured once and then replayed with one call."""

from typing import Any

import torch
from torch import Tensor

from eia_sec.learner.networks.cuda_graphs import capture
from eia_sec.learner.off_policy.algorithm import Algorithm, Batch, Diagnostics


class CapturedUpdates:
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
