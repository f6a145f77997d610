"""Updates on policy as CUDA graphs.

An update starts some four hundred small kernels, which takes Python ten times as long as a GPU needs to compute them.
Replaying a graph starts them all with one call. A graph holds for minibatches of one size, and for the types whose
actors have not stopped.
"""

from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import torch
from torch import Tensor

from learner.networks.cuda_graphs import capture
from learner.on_policy.minibatch import Minibatch

MOST_GRAPHS: Final = 8
"""How many graphs are kept; each has memory of its own for what its layers compute."""
Learn = Callable[[Minibatch], list[dict[str, Tensor]]]


class Captured(NamedTuple):
    """An update that can be replayed.

    Attributes:
        graph: what computes it.
        inputs: the buffers that it reads, in the order of `inputs_of`.
        names: of each type, what was measured.
        numbers: what was measured, [all names].
    """

    graph: torch.cuda.CUDAGraph
    inputs: list[Tensor]
    names: list[list[str]]
    numbers: Tensor


class CapturedUpdates:
    """The captured updates of networks without memory.

    Args:
        learn: computes an update of a minibatch and returns what it measured of each type.
        state: everything that `learn` changes.
        kinds: how many types there are.
    """

    def __init__(self, learn: Learn, state: Sequence[Tensor], kinds: int) -> None:
        self._learn, self._state, self._kinds = learn, state, kinds
        self._captured: OrderedDict[tuple[int, ...], Captured] = OrderedDict()

    def update(self, batch: Minibatch, stopped: Sequence[bool]) -> list[dict[str, Tensor]]:
        """Do the update; `stopped` says of each type whether its actors have stopped."""
        given, scalars = self._inputs_of(batch)
        graph = self._graph(batch, given, (len(batch.team), *map(int, stopped)))
        for mine, tensor in zip(graph.inputs, given, strict=False):
            mine.copy_(tensor)
        for mine, number in zip(graph.inputs[len(given) :], scalars, strict=True):
            mine.fill_(number)
        graph.graph.replay()
        numbers = iter(graph.numbers.clone().unbind())  # the next replay overwrites them
        return [{name: next(numbers) for name in names} for names in graph.names]

    def _inputs_of(self, batch: Minibatch) -> tuple[list[Tensor], tuple[float | Tensor, ...]]:
        """Return the tensors and the numbers that a minibatch consists of."""
        own = [batch.own(kind) for kind in range(self._kinds)]
        return [*own, batch.team, *batch.tensors.values()], (batch.entropy_weight, batch.rate_share)

    def _graph(self, batch: Minibatch, given: list[Tensor], kind: tuple[int, ...]) -> Captured:
        if kind not in self._captured:
            if len(self._captured) == MOST_GRAPHS:
                self._captured.popitem(last=False)
            self._captured[kind] = self._capture(batch, given)
        self._captured.move_to_end(kind)
        return self._captured[kind]

    def _capture(self, batch: Minibatch, given: list[Tensor]) -> Captured:
        inputs = [tensor.clone() for tensor in given]
        scalars = [torch.zeros((), device=batch.team.device) for _ in range(2)]
        own, team, rows = inputs[: self._kinds], inputs[self._kinds], inputs[self._kinds + 1 :]
        tensors = dict(zip(batch.tensors, rows, strict=True))
        mine = Minibatch(own.__getitem__, tensors, team, None, *scalars)

        def update() -> tuple[list[list[str]], Tensor]:
            found = self._learn(mine)
            numbers = [number.float() for measured in found for number in measured.values()]
            return [list(measured) for measured in found], torch.stack(numbers)

        graph, (names, numbers) = capture(update, self._state)
        return Captured(graph, [*inputs, *scalars], names, numbers)
