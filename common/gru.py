"""The gated recurrent unit (Cho et al. 2014) with which networks remember, in the form of torch.nn.GRUCell.

From an input x and the state h, both of width h:

    r  = sigmoid(x Wr + br + h Ur + cr)     how much of the state a candidate sees
    z  = sigmoid(x Wz + bz + h Uz + cz)     how much of the state stays
    n  = tanh(x Wn + bn + r (h Un + cn))    the candidate
    h' = n + z (h - n)                      the next state, and the output

The matrices of the three gates stand side by side, W = [Wr Wz Wn] and U = [Ur Uz Un], as do their biases b and c. A
state begins at 0 with its episode, and its numbers stay within -1 and 1.
"""

from typing import Final, get_args

import numpy as np

from eia_sec.common.config.algorithms.on_policy import Memory
from eia_sec.common.errors import SchemaError
from eia_sec.common.team import Float32

__all__ = ["Memory", "checked_memory", "next_state", "unit_shapes"]

MEMORIES: Final[tuple[Memory, ...]] = get_args(Memory)
MOST_STATE: Final = 1.001
"""Largest absolute value in a state that is accepted; rounding may exceed 1 by a little."""


def checked_memory(name: str) -> Memory:
    """Return the kind of memory of this name; raise SchemaError when there is none."""
    for memory in MEMORIES:
        if name == memory:
            return memory
    raise SchemaError(f"there is no memory {name[:40]!r}.")


def unit_shapes(hidden: int) -> list[tuple[int, ...]]:
    """Return the shapes of W, b, U, c."""
    return [(hidden, 3 * hidden), (3 * hidden,), (hidden, 3 * hidden), (3 * hidden,)]


def next_state(x: Float32, state: Float32, w: Float32, b: Float32, u: Float32, c: Float32) -> Float32:
    """Return the states h' after one step of several networks.

    Args:
        x: [n, B, h] inputs of the n networks.
        state: [n, B, h] states.
        w: [n, h, 3 h] W of each network.
        b: [n, 3 h] its biases.
        u: [n, h, 3 h] U of each network.
        c: [n, 3 h] its biases.
    """
    width = state.shape[-1]
    asked, known = np.matmul(x, w) + b[:, None], np.matmul(state, u) + c[:, None]
    gates = _sigmoid(asked[..., : 2 * width] + known[..., : 2 * width])
    reset, keep = gates[..., :width], gates[..., width:]
    candidate = np.tanh(asked[..., 2 * width :] + reset * known[..., 2 * width :])
    found: Float32 = candidate + keep * (state - candidate)
    return found


def _sigmoid(x: Float32) -> Float32:
    # Unlike 1 / (1 + exp(-x)), this form cannot overflow.
    half = np.float32(0.5)
    found: Float32 = half * (np.float32(1) + np.tanh(half * x))
    return found
