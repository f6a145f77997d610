"""`learner.networks.Pass` by compiled kernels, for one processor core."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from learner import kernels
from learner.kernels import COLUMNS, FAN_IN, FAN_OUT, FIRST, HEAD, OUTPUT, OWN, OWN_SIZE, ROW, ROWS, SECOND, Table
from learner.networks import Bank, Parameters, Pass, StackedPass


def make_pass(bank: Bank, like: Tensor, *, compiled: bool) -> Pass:
    """Return the pass of a bank: compiled, or stacked."""
    return CompiledPass(bank, like) if compiled else StackedPass(bank, like)


def storage(tensor: Tensor) -> NDArray[Any]:
    """Return all of a CPU tensor's storage as a flat array."""
    whole = tensor.as_strided((tensor.untyped_storage().nbytes() // tensor.element_size(),), (1,), 0)
    array: NDArray[Any] = whole.numpy()
    return array


class CompiledPass:
    """A `Pass` by the functions of `learner.kernels`; see there."""

    def __init__(self, bank: Bank, like: Tensor) -> None:
        self.bank = bank
        self._table = _table(bank)
        self._h1 = np.zeros(bank.rows * bank.hidden, like.new_empty(0).numpy().dtype)
        self._h2 = np.zeros_like(self._h1)
        space = max(s.rows * (2 * bank.hidden + s.action_size) for s in bank.stacks)
        self._scratch = np.zeros(space, self._h1.dtype)
        self.output = like.new_empty(bank.outputs)
        self._output = self.output.numpy()
        self._nothing = (self._h1[:0], np.zeros(0, np.int64))
        self._known: dict[tuple[int, ...], tuple[NDArray[Any], Table, Sequence[Tensor]]] = {}

    def _placed(self, tensors: Sequence[Tensor]) -> tuple[NDArray[Any], Table]:
        """Return the storage of one tensor for each stack, and where each network's part starts in it."""
        key = tuple(tensor.data_ptr() for tensor in tensors)
        found = self._known.get(key)
        if found is None:
            starts = [t.storage_offset() + n * t.stride(0) for t in tensors for n in range(t.shape[0])]
            # The tensors are kept, so that nothing else can come to stand at their addresses.
            found = self._known[key] = (storage(tensors[0]), np.array(starts, np.int64), tensors)
        return found[0], found[1]

    def forward(self, parameters: Parameters, inputs: Sequence[Tensor], delta: Sequence[Tensor] = ()) -> Tensor:
        """See `Pass`."""
        x, starts = self._placed(inputs)
        change, places = self._placed(delta) if delta else self._nothing
        flat = parameters.flat.numpy()
        kernels.forward(self._table, starts, x, flat, change, places, self._h1, self._h2, self._output)
        return self.output

    def parameter_gradient(
        self, parameters: Parameters, inputs: Sequence[Tensor], upstream: Tensor, into: Parameters
    ) -> None:
        """See `Pass`."""
        x, starts = self._placed(inputs)
        flat, above = parameters.flat.numpy(), upstream.numpy()
        kernels.parameter_gradient(
            self._table, starts, x, flat, above, self._h1, self._h2, self._scratch, into.flat.numpy()
        )

    def action_gradient(self, parameters: Parameters, upstream: Tensor, into: Sequence[Tensor]) -> None:
        """See `Pass`."""
        slopes, places = self._placed(into)
        flat, above = parameters.flat.numpy(), upstream.numpy()
        kernels.action_gradient(self._table, flat, above, self._h1, self._h2, self._scratch, slopes, places)


def _table(bank: Bank) -> Table:
    """Return where each network's parts are; see `learner.kernels`."""
    rows = np.zeros((sum(stack.count for stack in bank.stacks), COLUMNS), np.int64)
    n = output = 0
    for stack, first, second, head in zip(bank.stacks, *bank.typed, strict=True):
        for index in range(stack.count):
            line = rows[n]
            line[ROWS], line[FAN_IN], line[FAN_OUT] = stack.rows, 1 + stack.inputs, stack.outputs
            for column, block in ((FIRST, first), (SECOND, second), (HEAD, head)):
                line[column] = block.parameter + index * block.size
            line[ROW], line[OUTPUT] = first.row + index * stack.rows, output
            line[OWN], line[OWN_SIZE] = stack.action + index * stack.action_step, stack.action_size
            output += stack.rows * stack.outputs
            n += 1
    return rows
