"""The learner's arithmetic compiled for processor cores: passes of small networks, and Adam.

Networks are computed one after another, so that a network's numbers stay in the cache. All arrays are flat and
contiguous; a table says where each network's parts start. The products are those of
`eia_sec.learner.networks.matrix_products`.

Functions whose names end in `_on_cores` divide the same work: `bounds` says which rows of the table, or which numbers,
each core takes. A network's own numbers do not depend on the number of cores.
"""

from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from eia_sec.learner.networks.compilation import compiled, shared
from eia_sec.learner.networks.matrix_products import Floats, multiply, multiply_by_transposed, multiply_transposed

Table = NDArray[np.int64]

ROWS, FAN_IN, WIDTH, FAN_OUT, FIRST, SECOND, HEAD, ROW, OUTPUT, OWN, OWN_SIZE, COLUMNS = range(12)
"""Columns of a table: rows; inputs, with the leading one; units of a hidden layer; outputs; where each layer starts in
the flat parameters; where the rows start among all rows; where the outputs start; the first input of the own action,
and its size."""

APART: Final = 336
"""Numbers between the buffers of a network; without this gap, lines of all buffers would compete for one place in the
cache."""
SWEEP: Final = 2048
"""Parameters that Adam updates before it moves their targets, so that the parameters are still in the cache."""


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
        x: inputs, rows with a leading one.
        parameters: all layers.
        delta: what is added to the own actions; empty for nothing.
        places: where each network's part of `delta` starts.
        h1: activations of the first layer [all rows * hidden], written.
        h2: those of the second, written.
        output: written.
        piece: see `eia_sec.learner.networks.matrix_products.piece_size`.
    """
    width = table[0, WIDTH]
    none = np.zeros(width, h1.dtype)
    for n in range(table.shape[0]):
        rows, fan_in, fan_out = table[n, ROWS], table[n, FAN_IN], table[n, FAN_OUT]
        start, end = table[n, ROW] * width, (table[n, ROW] + rows) * width
        inputs = x[starts[n] : starts[n] + rows * fan_in].reshape((rows, fan_in))
        first = parameters[table[n, FIRST] : table[n, FIRST] + fan_in * width].reshape((fan_in, width))
        lower, upper = h1[start:end].reshape((rows, width)), h2[start:end].reshape((rows, width))
        multiply(inputs, first, lower, piece)
        if delta.shape[0] > 0:
            size, own = table[n, OWN_SIZE], table[n, OWN]
            _shift(lower, delta[places[n] : places[n] + rows * size].reshape((rows, size)), first[own : own + size])
        _rectify(lower, none)
        begin = table[n, SECOND]
        bias = parameters[begin : begin + width]
        second = parameters[begin + width : begin + width + width * width].reshape((width, width))
        multiply(lower, second, upper, piece)
        _rectify(upper, bias)
        begin = table[n, HEAD]
        bias = parameters[begin : begin + fan_out]
        head = parameters[begin + fan_out : begin + fan_out + width * fan_out]
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
        head = parameters[begin + fan_out : begin + fan_out + width * fan_out]
        out_gradient = into[begin + fan_out : begin + fan_out + width * fan_out]
        bias = into[begin : begin + fan_out]
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
        _column_sums(z2, into[begin : begin + width])
        second = parameters[begin + width : begin + width + width * width].reshape((width, width))
        gradients = into[begin + width : begin + width + width * width].reshape((width, width))
        multiply_transposed(lower, z2, gradients, piece)
        multiply_by_transposed(z2, second, z1, rest, piece)
        _mask(z1, lower)
        inputs = x[starts[n] : starts[n] + rows * fan_in].reshape((rows, fan_in))
        begin = table[n, FIRST]
        multiply_transposed(inputs, z1, into[begin : begin + fan_in * width].reshape((fan_in, width)), piece)


@compiled
def action_gradient(
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
    """Add to `into` the gradient of sum(upstream * output) by the own actions, for scalar networks."""
    width = table[0, WIDTH]
    for n in range(table.shape[0]):
        rows = table[n, ROWS]
        start, end = table[n, ROW] * width, (table[n, ROW] + rows) * width
        lower, upper = h1[start:end].reshape((rows, width)), h2[start:end].reshape((rows, width))
        z2, z1, rest = _scratch(scratch, rows, width)
        above = upstream[table[n, OUTPUT] : table[n, OUTPUT] + rows]
        begin = table[n, HEAD]
        _outer(above, parameters[begin + 1 : begin + 1 + width], upper, z2)
        begin = table[n, SECOND] + width
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
    """Write max(values + bias, 0). Without a bias, callers pass zeros, which keeps the loop vectorised."""
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


@compiled
def adam(
    parameters: Floats,
    gradient: Floats,
    mean: Floats,
    square: Floats,
    settings: Floats,
    target: Floats,
) -> None:
    """Take one Adam step in one sweep, and let the target follow where there is one.

    Args:
        parameters: [P], changed.
        gradient: [P].
        mean: first moments [P], changed.
        square: second moments [P], changed.
        settings: 1 - beta1, beta2, 1 - beta2, the scaled rate, the scaled epsilon, xi.
        target: [P], or empty.
    """
    blend, keep, take, rate, epsilon, follow = settings
    for start in range(0, parameters.shape[0], SWEEP):
        part = slice(start, start + SWEEP)
        values, gradients = parameters[part], gradient[part]
        means, squares, followers = mean[part], square[part], target[part]
        for i in range(values.shape[0]):
            first = means[i] + (gradients[i] - means[i]) * blend
            second = squares[i] * keep + gradients[i] * gradients[i] * take
            means[i], squares[i] = first, second
            values[i] -= rate * first / (np.sqrt(second) + epsilon)
        for i in range(followers.shape[0]):
            followers[i] += (values[i] - followers[i]) * follow


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
def action_gradient_on_cores(
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
    """Do `action_gradient` on several cores, each with a sum of its own and `scratch_size` numbers of `scratch`."""
    parts = bounds.shape[0] - 1
    size = scratch.shape[0] // parts
    sums = np.zeros((parts, into.shape[0]), into.dtype)
    for part in numba.prange(parts):
        a, b = bounds[part], bounds[part + 1]
        own = scratch[part * size : (part + 1) * size]
        action_gradient(table[a:b], parameters, upstream, h1, h2, own, sums[part], places[a:b], piece)
    for part in range(parts):
        for k in range(into.shape[0]):
            into[k] += sums[part, k]


@shared
def adam_on_cores(
    bounds: Table,
    parameters: Floats,
    gradient: Floats,
    mean: Floats,
    square: Floats,
    settings: Floats,
    target: Floats,
) -> None:
    """Do `adam` on several cores."""
    for part in numba.prange(bounds.shape[0] - 1):
        a, b = bounds[part], bounds[part + 1]
        adam(parameters[a:b], gradient[a:b], mean[a:b], square[a:b], settings, target[a:b])
