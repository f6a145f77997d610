"""The perceptrons of `eia_sec.learner.networks.stacks` compiled for processor cores, with their gradients.

Autograd sees one operation, `Compiled`. Its gradients are written out; tests compare them with torch's.
Networks are computed one after another, so that a network's numbers stay in the cache. All arrays are flat and
contiguous; a table says where each network's parts start. The products are those of
`eia_sec.learner.networks.matrix_products`.

Functions whose names end in `_on_cores` divide the same work: `bounds` says which rows of the table, or which numbers,
each core takes. A network's own numbers do not depend on the number of cores.
"""

import itertools
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numba
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from eia_sec.learner.networks.compilation import compiled, shared
from eia_sec.learner.networks.matrix_products import (
    Floats,
    multiply,
    multiply_by_transposed,
    multiply_transposed,
    piece_size,
)

if TYPE_CHECKING:
    from eia_sec.learner.networks.stacks import Shape

Table = NDArray[np.int64]

ROWS, FAN_IN, WIDTH, FAN_OUT, FIRST, SECOND, HEAD, ROW, OUTPUT, OWN, OWN_SIZE, COLUMNS = range(12)
"""Columns of a table: rows; inputs; units of a hidden layer; outputs; where each layer's weights start in the flat
parameters, with its biases behind them; where the rows start among all rows; where the outputs start; the first input
that a change is added to, and how many there are."""

APART: Final = 336
"""Numbers between the buffers of a network; without this gap, lines of all buffers would compete for one place in the
cache."""

LINE: Final = 16
"""Each network's parameters start at a multiple of so many numbers. Else vectors of its weights would lie across cache
lines, which costs a tenth of an update's time and more."""


@compiled
def forward(
    table: Table,
    starts: Table,
    x: Floats,
    parameters: Floats,
    delta: Floats,
    places: Table,
    h1: Floats,
    h2: Floats,
    output: Floats,
    piece: int,
) -> None:
    """Compute h1, h2 and the outputs of all networks.

    Args:
        table: one row for each network, see above.
        starts: where each network's inputs start in `x`.
        x: inputs.
        parameters: all layers.
        delta: what is added to inputs; empty for nothing.
        places: where each network's part of `delta` starts.
        h1: activations of the first layer [all rows * hidden], written.
        h2: those of the second, written.
        output: written.
        piece: see `eia_sec.learner.networks.matrix_products.piece_size`.
    """
    width = table[0, WIDTH]
    for n in range(table.shape[0]):
        rows, fan_in, fan_out = table[n, ROWS], table[n, FAN_IN], table[n, FAN_OUT]
        start, end = table[n, ROW] * width, (table[n, ROW] + rows) * width
        inputs = x[starts[n] : starts[n] + rows * fan_in].reshape((rows, fan_in))
        begin = table[n, FIRST]
        first = parameters[begin : begin + fan_in * width].reshape((fan_in, width))
        bias = parameters[begin + fan_in * width : begin + (fan_in + 1) * width]
        lower, upper = h1[start:end].reshape((rows, width)), h2[start:end].reshape((rows, width))
        multiply(inputs, first, lower, piece)
        if delta.shape[0] > 0:
            size, own = table[n, OWN_SIZE], table[n, OWN]
            _shift(lower, delta[places[n] : places[n] + rows * size].reshape((rows, size)), first[own : own + size])
        _rectify(lower, bias)
        begin = table[n, SECOND]
        second = parameters[begin : begin + width * width].reshape((width, width))
        bias = parameters[begin + width * width : begin + (width + 1) * width]
        multiply(lower, second, upper, piece)
        _rectify(upper, bias)
        begin = table[n, HEAD]
        head = parameters[begin : begin + width * fan_out]
        bias = parameters[begin + width * fan_out : begin + (width + 1) * fan_out]
        result = output[table[n, OUTPUT] : table[n, OUTPUT] + rows * fan_out]
        if fan_out == 1:
            np.dot(upper, head, result)
            result += bias[0]
        else:
            wide = result.reshape((rows, fan_out))
            np.dot(upper, head.reshape((width, fan_out)), wide)
            for r in range(rows):
                for c in range(fan_out):
                    wide[r, c] += bias[c]


@compiled
def parameter_gradient(
    table: Table,
    starts: Table,
    x: Floats,
    parameters: Floats,
    upstream: Floats,
    h1: Floats,
    h2: Floats,
    scratch: Floats,
    into: Floats,
    piece: int,
) -> None:
    """Write the gradient of sum(upstream * output) by all parameters.

    `scratch` has `scratch_size` numbers.
    """
    width = table[0, WIDTH]
    for n in range(table.shape[0]):
        rows, fan_in, fan_out = table[n, ROWS], table[n, FAN_IN], table[n, FAN_OUT]
        start, end = table[n, ROW] * width, (table[n, ROW] + rows) * width
        lower, upper = h1[start:end].reshape((rows, width)), h2[start:end].reshape((rows, width))
        z2, z1, rest = _scratch(scratch, rows, width)
        above = upstream[table[n, OUTPUT] : table[n, OUTPUT] + rows * fan_out]
        begin = table[n, HEAD]
        head = parameters[begin : begin + width * fan_out]
        out_gradient = into[begin : begin + width * fan_out]
        bias = into[begin + width * fan_out : begin + (width + 1) * fan_out]
        if fan_out == 1:
            bias[0] = above.sum()
            np.dot(upper.T, above, out_gradient)
            _outer(above, head, upper, z2)
        else:
            wide = above.reshape((rows, fan_out))
            _column_sums(wide, bias)
            np.dot(upper.T, wide, out_gradient.reshape((width, fan_out)))
            np.dot(wide, head.reshape((width, fan_out)).T, z2)
            _mask(z2, upper)
        begin = table[n, SECOND]
        second = parameters[begin : begin + width * width].reshape((width, width))
        gradients = into[begin : begin + width * width].reshape((width, width))
        _column_sums(z2, into[begin + width * width : begin + (width + 1) * width])
        multiply_transposed(lower, z2, gradients, piece)
        multiply_by_transposed(z2, second, z1, rest, piece)
        _mask(z1, lower)
        inputs = x[starts[n] : starts[n] + rows * fan_in].reshape((rows, fan_in))
        begin = table[n, FIRST]
        multiply_transposed(inputs, z1, into[begin : begin + fan_in * width].reshape((fan_in, width)), piece)
        _column_sums(z1, into[begin + fan_in * width : begin + (fan_in + 1) * width])


@compiled
def change_gradient(
    table: Table,
    parameters: Floats,
    upstream: Floats,
    h1: Floats,
    h2: Floats,
    scratch: Floats,
    into: Floats,
    places: Table,
    piece: int,
) -> None:
    """Add to `into` the gradient of sum(upstream * output) by the change of inputs, for scalar networks."""
    width = table[0, WIDTH]
    for n in range(table.shape[0]):
        rows = table[n, ROWS]
        start, end = table[n, ROW] * width, (table[n, ROW] + rows) * width
        lower, upper = h1[start:end].reshape((rows, width)), h2[start:end].reshape((rows, width))
        z2, z1, rest = _scratch(scratch, rows, width)
        above = upstream[table[n, OUTPUT] : table[n, OUTPUT] + rows]
        begin = table[n, HEAD]
        _outer(above, parameters[begin : begin + width], upper, z2)
        begin = table[n, SECOND]
        second = parameters[begin : begin + width * width].reshape((width, width))
        multiply_by_transposed(z2, second, z1, rest, piece)
        _mask(z1, lower)
        size, own = table[n, OWN_SIZE], table[n, FIRST] + table[n, OWN] * width
        part = rest[: rows * size]
        np.dot(z1, parameters[own : own + size * width].reshape((size, width)).T, part.reshape((rows, size)))
        out_gradient = into[places[n] : places[n] + rows * size]
        for k in range(rows * size):
            out_gradient[k] += part[k]


def scratch_size(rows: int, width: int, action: int) -> int:
    """Return how many numbers of scratch the gradients of one network need."""
    return 2 * (rows * width + APART) + max(rows * action, width * width)


@compiled
def _scratch(scratch: Floats, rows: int, width: int) -> tuple[Floats, Floats, Floats]:
    """Return two buffers [rows, width] and the numbers behind them."""
    size = rows * width
    first, second = scratch[:size], scratch[size + APART : 2 * size + APART]
    return first.reshape((rows, width)), second.reshape((rows, width)), scratch[2 * (size + APART) :]


@compiled
def _shift(sums: Floats, change: Floats, weights: Floats) -> None:
    """Add the effect of a change of a few inputs [rows, a] to sums [rows, width]."""
    for r in range(sums.shape[0]):
        for k in range(change.shape[1]):
            for c in range(sums.shape[1]):
                sums[r, c] += change[r, k] * weights[k, c]


@compiled
def _rectify(values: Floats, bias: Floats) -> None:
    """Write max(values + bias, 0)."""
    for r in range(values.shape[0]):
        for c in range(values.shape[1]):
            value = values[r, c] + bias[c]
            values[r, c] = value if value > 0 else values.dtype.type(0)


@compiled
def _mask(gradient: Floats, activation: Floats) -> None:
    for r in range(gradient.shape[0]):
        for c in range(gradient.shape[1]):
            gradient[r, c] = gradient[r, c] if activation[r, c] > 0 else gradient.dtype.type(0)


@compiled
def _outer(above: Floats, head: Floats, activation: Floats, out: Floats) -> None:
    """Write the gradient by the sums below a scalar head: above head^T where the activation is above 0, else 0."""
    for r in range(out.shape[0]):
        out_gradient, active, row = above[r], activation[r], out[r]
        for c in range(head.shape[0]):
            row[c] = out_gradient * head[c] if active[c] > 0 else out.dtype.type(0)


@compiled
def _column_sums(values: Floats, out: Floats) -> None:
    out[:] = 0
    for r in range(values.shape[0]):
        for c in range(values.shape[1]):
            out[c] += values[r, c]


@shared
def forward_on_cores(
    bounds: Table,
    table: Table,
    starts: Table,
    x: Floats,
    parameters: Floats,
    delta: Floats,
    places: Table,
    h1: Floats,
    h2: Floats,
    output: Floats,
    piece: int,
) -> None:
    """Do `forward` on several cores; `places` has an entry for each network even if `delta` is empty."""
    for part in numba.prange(bounds.shape[0] - 1):
        a, b = bounds[part], bounds[part + 1]
        forward(table[a:b], starts[a:b], x, parameters, delta, places[a:b], h1, h2, output, piece)


@shared
def parameter_gradient_on_cores(
    bounds: Table,
    table: Table,
    starts: Table,
    x: Floats,
    parameters: Floats,
    upstream: Floats,
    h1: Floats,
    h2: Floats,
    scratch: Floats,
    into: Floats,
    piece: int,
) -> None:
    """Do `parameter_gradient` on several cores, each with `scratch_size` numbers of `scratch`."""
    size = scratch.shape[0] // (bounds.shape[0] - 1)
    for part in numba.prange(bounds.shape[0] - 1):
        a, b = bounds[part], bounds[part + 1]
        own = scratch[part * size : (part + 1) * size]
        parameter_gradient(table[a:b], starts[a:b], x, parameters, upstream, h1, h2, own, into, piece)


@shared
def change_gradient_on_cores(
    bounds: Table,
    table: Table,
    parameters: Floats,
    upstream: Floats,
    h1: Floats,
    h2: Floats,
    scratch: Floats,
    into: Floats,
    places: Table,
    piece: int,
) -> None:
    """Do `change_gradient` on several cores, each with a sum of its own and `scratch_size` numbers of `scratch`."""
    parts = bounds.shape[0] - 1
    size = scratch.shape[0] // parts
    sums = np.zeros((parts, into.shape[0]), into.dtype)
    for part in numba.prange(parts):
        a, b = bounds[part], bounds[part + 1]
        own = scratch[part * size : (part + 1) * size]
        change_gradient(table[a:b], parameters, upstream, h1, h2, own, sums[part], places[a:b], piece)
    for part in range(parts):
        for k in range(into.shape[0]):
            into[k] += sums[part, k]


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


def parameter_room(shape: "Shape", hidden: int) -> int:
    """Return how many numbers the parameters of one network take up, those after them up to a `LINE` included."""
    size = (shape.inputs + 1) * hidden + (hidden + 1) * (hidden + shape.outputs)
    return -(-size // LINE) * LINE


def usable_cores(threads: int) -> int:
    """Return how many cores the kernels can use, given the threads of torch; numba has a limit of its own."""
    return int(min(threads, vars(numba.config)["NUMBA_NUM_THREADS"]))


def storage(tensor: Tensor) -> NDArray[Any]:
    """Return all of a CPU tensor's storage as a flat array."""
    whole = tensor.as_strided((tensor.untyped_storage().nbytes() // tensor.element_size(),), (1,), 0)
    array: NDArray[Any] = whole.numpy()
    return array


def outputs(networks: "CompiledNetworks", inputs: Sequence[Tensor], flat: Tensor, change: Tensor | None) -> Tensor:
    """Return the outputs of networks; see `eia_sec.learner.networks.stacks.Stacks.forward`.

    Args:
        networks: what computes them.
        inputs: of each stack.
        flat: all parameters.
        change: what is added to inputs, or None.
    """
    if not torch.is_grad_enabled():
        return networks.forward(inputs, flat, change)
    output: Tensor = Compiled.apply(networks, inputs, flat, change)  # type: ignore[no-untyped-call]  # torch leaves it untyped
    return output


class CompiledNetworks:
    """The networks of one role with the buffers of their newest pass.

    Args:
        shapes: of each stack.
        hidden: width of the hidden layers.
        like: a tensor of the wanted type, on the processor.
        cores: processor cores, 1 or more.
    """

    def __init__(self, shapes: Sequence["Shape"], hidden: int, like: Tensor, cores: int) -> None:
        self.newest = 0
        table = _table(shapes, hidden)
        costs = table[:, ROWS] * table[:, WIDTH] * (table[:, FAN_IN] + table[:, WIDTH] + table[:, FAN_OUT])
        self._order, self._bounds = shares(costs.tolist(), cores)
        self._table, self._parts = table[self._order], self._bounds.shape[0] - 1
        size, kind = sum(s.count * s.rows for s in shapes) * hidden, like.new_empty(0).numpy().dtype
        buffers = np.zeros(2 * size + APART, kind)
        self._h1, self._h2 = buffers[:size], buffers[size + APART :]
        space = max(scratch_size(s.rows, hidden, s.changes.size if s.changes else 0) for s in shapes)
        self._piece, self._outputs = piece_size(), sum(s.count * s.rows * s.outputs for s in shapes)
        self._scratch = np.zeros(self._parts * space, kind)
        self._places = np.array(_places(shapes), np.int64)[self._order]
        self._nothing = np.zeros(0, kind)
        self._known: dict[tuple[int, int], tuple[NDArray[Any], Table, Sequence[Tensor]]] = {}

    def _placed(self, inputs: Sequence[Tensor]) -> tuple[NDArray[Any], Table]:
        """Return the storage of the stacks' inputs, and where each network's inputs start in it."""
        key = inputs[0].data_ptr(), len(inputs)
        if key not in self._known:
            starts = [t.storage_offset() + n * t.stride(0) for t in inputs for n in range(t.shape[0])]
            # Keeping the tensors keeps their addresses from being reused.
            self._known[key] = storage(inputs[0]), np.array(starts, np.int64)[self._order], inputs
        return self._known[key][:2]

    def forward(self, inputs: Sequence[Tensor], flat: Tensor, change: Tensor | None) -> Tensor:
        """Return the outputs of all networks, flat."""
        self.newest += 1
        flat = flat.detach()
        x, starts = self._placed(inputs)
        added, output = self._nothing if change is None else change.numpy(), flat.new_empty(self._outputs)
        work = self._table, starts, x, flat.numpy(), added, self._places, self._h1, self._h2, output.numpy()
        if self._parts > 1:
            forward_on_cores(self._bounds, *work, self._piece)
        else:
            forward(*work, self._piece)
        return output

    def by_parameters(self, inputs: Sequence[Tensor], flat: Tensor, upstream: Tensor) -> Tensor:
        """Return the gradient of sum(upstream * output) of the newest pass by the parameters."""
        x, starts = self._placed(inputs)
        into = torch.zeros_like(flat)
        work = (
            *(self._table, starts, x, flat.numpy(), upstream.numpy()),
            *(self._h1, self._h2, self._scratch, into.numpy()),
        )
        if self._parts > 1:
            parameter_gradient_on_cores(self._bounds, *work, self._piece)
        else:
            parameter_gradient(*work, self._piece)
        return into

    def by_change(self, flat: Tensor, change: Tensor, upstream: Tensor) -> Tensor:
        """Return the gradient of sum(upstream * output) of the newest pass, of scalar networks, by `change`."""
        into = torch.zeros_like(change)
        work = (
            *(self._table, flat.numpy(), upstream.numpy(), self._h1, self._h2),
            *(self._scratch, into.numpy(), self._places),
        )
        if self._parts > 1:
            change_gradient_on_cores(self._bounds, *work, self._piece)
        else:
            change_gradient(*work, self._piece)
        return into


class Compiled(torch.autograd.Function):
    """The outputs of `CompiledNetworks` as an operation that autograd differentiates, once each."""

    @staticmethod
    def forward(
        ctx: Any, networks: CompiledNetworks, inputs: Sequence[Tensor], flat: Tensor, change: Tensor | None
    ) -> Tensor:
        """Return the outputs; arguments as for `outputs`."""
        change = None if change is None else change.detach().contiguous()
        output = networks.forward(inputs, flat, change)
        ctx.made = networks, inputs, flat.detach(), change, networks.newest
        return output

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[None, None, Tensor | None, Tensor | None]:
        """Return the gradients by parameters and change.

        Raises:
            RuntimeError: another pass of these networks has followed, whose activations stand in their buffers.
        """
        networks, inputs, flat, change, number = ctx.made
        if number != networks.newest:
            raise RuntimeError("a later forward pass has overwritten the activations that this gradient needs.")
        _, _, by_flat, by_change = ctx.needs_input_grad
        upstream = upstream.contiguous()
        return (
            None,
            None,
            networks.by_parameters(inputs, flat, upstream) if by_flat else None,
            networks.by_change(flat, change, upstream) if by_change else None,
        )


def _table(shapes: Sequence["Shape"], width: int) -> Table:
    """Return where each network's parts start: the table of this module."""
    lines = []
    parameter = row = output = 0
    for shape in shapes:
        second = (shape.inputs + 1) * width
        head = second + (width + 1) * width
        changes = shape.changes
        for index in range(shape.count):
            own, size = (0, 0) if changes is None else (changes.first + index * changes.step, changes.size)
            starts = parameter, parameter + second, parameter + head, row, output
            lines.append((shape.rows, shape.inputs, width, shape.outputs, *starts, own, size))
            parameter += parameter_room(shape, width)
            row += shape.rows
            output += shape.rows * shape.outputs
    return np.array(lines, np.int64)


def _places(shapes: Sequence["Shape"]) -> list[int]:
    """Return where each network's part of a change starts."""
    places = []
    for shape in shapes:
        changes = shape.changes
        for index in range(shape.count):
            apart = 0 if changes is None or changes.shared else index * shape.rows * changes.size
            places.append(0 if changes is None else changes.start + apart)
    return places
