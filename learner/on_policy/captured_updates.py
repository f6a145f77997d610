"""Updates on policy as CUDA graphs.

Starting an update's four hundred kernels from Python takes ten times as long as computing them. Replaying a graph
starts them all with one call. A graph fits one size of minibatch and one set of types whose actors have stopped.
"""

from collections import OrderedDict
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

import torch
from torch import Tensor

from eia_sec.learner.networks.cuda_graphs import capture
from eia_sec.learner.on_policy.minibatch import Minibatch

MOST_GRAPHS: Final = 16
"""How many graphs are kept: with three types, those of two sizes. Each has memory of its own."""
Learn = Callable[[Minibatch], list[dict[str, Tensor]]]


class Captured(NamedTuple):
    """An update that can be replayed.

    Attributes:
        graph: what computes it.
        own: the buffers of each type's observations that it reads.
        batch: its minibatch, which consists of buffers.
        schedules: the buffers of its schedules' values.
        names: of each type, what was measured.
        numbers: what was measured, [all names].
    """

    graph: torch.cuda.CUDAGraph
    own: list[Tensor]
    batch: Minibatch
    schedules: list[Tensor]
    names: list[list[str]]
    numbers: Tensor


class CapturedUpdates:
    """The captured updates of networks without memory.

    Args:
        state: everything that an update changes.
        kinds: how many types there are.
    """

    def __init__(self, state: Sequence[Tensor], kinds: int) -> None:
        self._state, self._kinds = state, kinds
        self._captured: OrderedDict[tuple[int, ...], Captured] = OrderedDict()

    def __len__(self) -> int:
        """How many graphs there are."""
        return len(self._captured)

    def update(self, learn: Learn, batch: Minibatch) -> list[dict[str, Tensor]]:
        """Do the update; `learn` computes it from a minibatch and returns what it measured of each type."""
        captured = self._graph(learn, batch)
        for kind, mine in enumerate(captured.own):
            mine.copy_(batch.own(kind))
        for name, mine in captured.batch.tensors.items():
            mine.copy_(batch.tensors[name])
        captured.batch.team.copy_(batch.team)
        for mine, number in zip(captured.schedules, (batch.entropy_weight, batch.rate_share), strict=True):
            mine.fill_(number)
        captured.graph.replay()
        numbers = iter(captured.numbers.clone().unbind())  # the next replay overwrites them
        return [{name: next(numbers) for name in names} for names in captured.names]

    def _graph(self, learn: Learn, batch: Minibatch) -> Captured:
        """Return the graph for such a minibatch, after capturing it if there is none."""
        key = (len(batch.team), *map(int, batch.stopped))
        if key not in self._captured:
            if len(self._captured) == MOST_GRAPHS:
                self._captured.popitem(last=False)
            self._captured[key] = self._capture(learn, batch)
        self._captured.move_to_end(key)
        return self._captured[key]

    def _capture(self, learn: Learn, batch: Minibatch) -> Captured:
        own = [batch.own(kind) for kind in range(self._kinds)]
        schedules = [torch.zeros((), device=batch.team.device) for _ in range(2)]
        tensors = {name: tensor.clone() for name, tensor in batch.tensors.items()}
        mine = Minibatch(own.__getitem__, tensors, batch.team.clone(), None, batch.stopped, *schedules)

        def update() -> tuple[list[list[str]], Tensor]:
            found = learn(mine)
            numbers = [number.float() for measured in found for number in measured.values()]
            return [list(measured) for measured in found], torch.stack(numbers)

        graph, (names, numbers) = capture(update, self._state)
        return Captured(graph, own, mine, schedules, names, numbers)
