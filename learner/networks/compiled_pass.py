"""A `Pass` (see `eia_sec.learner.networks.stacked`) that runs compiled kernels on one or more processor cores."""

import itertools
from collections.abc import Sequence
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from eia_sec.learner.networks import kernels
from eia_sec.learner.networks.kernels import (
    COLUMNS,
    FAN_IN,
    FAN_OUT,
    FIRST,
    HEAD,
    OUTPUT,
    OWN,
    OWN_SIZE,
    ROW,
    ROWS,
    SECOND,
    WIDTH,
    Table,
)
from eia_sec.learner.networks.matrix_products import piece_size
from eia_sec.learner.networks.stacked import Forward, ForwardCounter, Networks, Parameters, Pass, StackedPass


def make_pass(networks: Networks, like: Tensor, *, cores: int) -> Pass:
    """Return a pass for these networks: compiled for `cores` processor cores, or stacked if `cores` is 0."""
    return CompiledPass(networks, like, cores) if cores else StackedPass(networks, like)


def shares(costs: Sequence[float], cores: int) -> tuple[Table, Table]:
    """Distribute items so that all cores take about as long: the costliest first, each to the core with the least.

    Returns:
        the items in an order that keeps each core's together; where each core's items start, and the end [parts + 1].
    """
    parts: list[list[int]] = [[] for _ in range(max(1, min(cores, len(costs))))]
    loads = [0.0] * len(parts)
    for item in sorted(range(len(costs)), key=lambda item: -costs[item]):
        least = loads.index(min(loads))
        parts[least].append(item)
        loads[least] += costs[item]
    order = [item for part in parts for item in sorted(part)]
    bounds = [0, *itertools.accumulate(len(part) for part in parts)]
    return np.array(order, np.int64), np.array(bounds, np.int64)


def usable_cores(threads: int) -> int:
    """Return how many cores the kernels can use, given the threads of torch; numba has a limit of its own."""
    return int(min(threads, vars(numba.config)["NUMBA_NUM_THREADS"]))


def even(size: int, cores: int) -> Table:
    """Divide a vector evenly among cores; return where each core's part starts, and the end [cores + 1]."""
    return np.linspace(0, size, cores + 1).astype(np.int64)


def storage(tensor: Tensor) -> NDArray[Any]:
    """Return all of a CPU tensor's storage as a flat array."""
    whole = tensor.as_strided((tensor.untyped_storage().nbytes() // tensor.element_size(),), (1,), 0)
    array: NDArray[Any] = whole.numpy()
    return array


class CompiledPass:
    """A `Pass` that calls the functions of `eia_sec.learner.networks.kernels`."""

    def __init__(self, networks: Networks, like: Tensor, cores: int) -> None:
        self.networks = networks
        self._counter = ForwardCounter()
        table = _table(networks)
        costs = table[:, ROWS] * table[:, WIDTH] * (table[:, FAN_IN] + table[:, WIDTH] + table[:, FAN_OUT])
        self._order, self._bounds = shares(costs.tolist(), cores)
        self._table, self._parts = table[self._order], self._bounds.shape[0] - 1
        size, kind = networks.rows * networks.hidden, like.new_empty(0).numpy().dtype
        hidden = np.zeros(2 * size + kernels.APART, kind)
        self._h1, self._h2 = hidden[:size], hidden[size + kernels.APART :]
        space = max(kernels.scratch_size(s.rows, networks.hidden, s.action_size) for s in networks.stacks)
        self._piece = piece_size()
        self._scratch = np.zeros(self._parts * space, self._h1.dtype)
        self._output = like.new_empty(networks.outputs)
        self._array = self._output.numpy()
        self._nothing = (self._h1[:0], np.zeros(table.shape[0], np.int64))
        self._known: dict[tuple[int, ...], tuple[NDArray[Any], Table, Sequence[Tensor]]] = {}

    def _placed(self, tensors: Sequence[Tensor]) -> tuple[NDArray[Any], Table]:
        """Return the storage of one tensor for each stack, and where each network's part starts in it."""
        # All are views of one storage in the team's order, so these four numbers identify the list of tensors.
        key = tensors[0].data_ptr(), tensors[0].stride(0), tensors[-1].data_ptr(), len(tensors)
        found = self._known.get(key)
        if found is None:
            starts = [t.storage_offset() + n * t.stride(0) for t in tensors for n in range(t.shape[0])]
            # Keeping the tensors keeps their addresses from being reused.
            found = self._known[key] = (storage(tensors[0]), np.array(starts, np.int64)[self._order], tensors)
        return found[0], found[1]

    def forward(self, parameters: Parameters, inputs: Sequence[Tensor], delta: Sequence[Tensor] = ()) -> Forward:
        """See `Pass`."""
        x, starts = self._placed(inputs)
        change, places = self._placed(delta) if delta else self._nothing
        work = self._table, starts, x, parameters.flat.numpy(), change, places, self._h1, self._h2, self._array
        if self._parts > 1:
            kernels.forward_on_cores(self._bounds, *work, self._piece)
        else:
            kernels.forward(*work, self._piece)
        return Forward(parameters, inputs, self._output, self._counter.next())

    def parameter_gradient(self, forward: Forward, upstream: Tensor, into: Parameters) -> None:
        """See `Pass`."""
        self._counter.check(forward)
        x, starts = self._placed(forward.inputs)
        flat, above = forward.parameters.flat.numpy(), upstream.numpy()
        work = self._table, starts, x, flat, above, self._h1, self._h2, self._scratch, into.flat.numpy()
        if self._parts > 1:
            kernels.parameter_gradient_on_cores(self._bounds, *work, self._piece)
        else:
            kernels.parameter_gradient(*work, self._piece)

    def action_gradient(self, forward: Forward, upstream: Tensor, into: Sequence[Tensor]) -> None:
        """See `Pass`."""
        self._counter.check(forward)
        gradients, places = self._placed(into)
        flat, above = forward.parameters.flat.numpy(), upstream.numpy()
        work = self._table, flat, above, self._h1, self._h2, self._scratch, gradients, places
        if self._parts > 1:
            kernels.action_gradient_on_cores(self._bounds, *work, self._piece)
        else:
            kernels.action_gradient(*work, self._piece)


def _table(networks: Networks) -> Table:
    """Return where each network's parts start: the table of `eia_sec.learner.networks.kernels`."""
    rows = np.zeros((sum(stack.count for stack in networks.stacks), COLUMNS), np.int64)
    n = output = 0
    for stack, first, second, head in zip(networks.stacks, *networks.typed, strict=True):
        for index in range(stack.count):
            line = rows[n]
            line[ROWS], line[FAN_IN], line[FAN_OUT] = stack.rows, 1 + stack.inputs, stack.outputs
            line[WIDTH] = networks.hidden
            for column, block in ((FIRST, first), (SECOND, second), (HEAD, head)):
                line[column] = block.parameter + index * block.size
            line[ROW], line[OUTPUT] = first.row + index * stack.rows, output
            line[OWN], line[OWN_SIZE] = stack.action + index * stack.action_step, stack.action_size
            output += stack.rows * stack.outputs
            n += 1
    return rows
