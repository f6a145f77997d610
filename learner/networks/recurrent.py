"""Networks with memory: a hidden ReLU layer, a gated recurrent unit (`eia_sec.common.gru`) and an output layer.

A stack has eight layers with a leading axis S, in the order of `eia_sec.common.actors`: W1, b1, W, b, U, c, W3, b3.
"""

import math
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from eia_sec.common.config import OnPolicyConfig
from eia_sec.common.gru import Memory
from eia_sec.common.team import Shape
from eia_sec.learner.networks.module_stack import ModuleStack
from eia_sec.learner.networks.sequences import Sequences, Unroll
from eia_sec.learner.networks.stack import Stack, orthogonal

GATES = 3
"""Matrices side by side in W and in U."""


class RecurrentStack(Stack):
    """S networks with memory; arguments as for `Stack`.

    States are float32 whatever the type of the inputs, because rounding errors would add up from step to step.
    """

    memory: ClassVar[Memory] = "gru"

    def initialise(self, row: int, generator: np.random.Generator, gain: float) -> None:
        """Draw the weights of one network; the unit's matrices are orthogonal one by one, with a gain of 1."""
        w1, _, w, _, u, _, w3, _ = self.layers
        w1[row] = torch.from_numpy(orthogonal(tuple(w1[row].shape), math.sqrt(2.0), generator))
        for layer in (w, u):
            square = layer.shape[1], layer.shape[1]
            parts = [orthogonal(square, 1.0, generator) for _ in range(GATES)]
            layer[row] = torch.from_numpy(np.concatenate(parts, axis=1))
        w3[row] = torch.from_numpy(orthogonal(tuple(w3[row].shape), gain, generator))

    def forward(self, x: Tensor, sequences: Sequences | None = None) -> Tensor:
        """Return the outputs [L B, n, outputs] of each agent's network; arguments as for `unroll`."""
        assert sequences is not None
        return self.unroll(x, sequences).outputs

    def unroll(self, x: Tensor, sequences: Sequences) -> Unroll:
        """Let each agent's network go through sequences.

        Args:
            x: [L B, n, inputs] where S is 1 or n.
            sequences: B sequences of L rows, with states of the n networks.
        """
        agents, (steps, batch) = x.shape[1], sequences.keep.shape
        w1, b1, w, b, u, c, w3, b3 = self.layers_as(x.dtype)
        hidden = torch.relu_(torch.baddbmm(b1[:, None], self._by_network(x), w1))
        asked = torch.baddbmm(b[:, None], hidden, w).float()
        keep = sequences.keep.repeat_interleave(agents, dim=1) if self.count == 1 else sequences.keep
        state, states = self._by_network(sequences.state), []
        for own, goes_on in zip(asked.view(self.count, steps, -1, asked.shape[2]).unbind(1), keep, strict=True):
            state = _next_state(own, state * goes_on[:, None], u, c)
            states.append(state)
        found = torch.stack(states, dim=1).flatten(1, 2)
        outputs = torch.baddbmm(b3[:, None], found, w3)
        return Unroll(self._by_row(outputs, steps * batch), self._by_row(found, steps * batch))

    def _by_network(self, x: Tensor) -> Tensor:
        """Return [B, n, ...] as [S, B n / S, ...]."""
        return x.reshape(1, -1, x.shape[2]) if self.count == 1 else x.transpose(0, 1)

    def _by_row(self, x: Tensor, rows: int) -> Tensor:
        """Undo `_by_network`."""
        return x.view(rows, -1, x.shape[2]) if self.count == 1 else x.transpose(0, 1)


def _next_state(asked: Tensor, state: Tensor, u: Tensor, c: Tensor) -> Tensor:
    """Return h' of `eia_sec.common.gru`.

    Args:
        asked: [S, B, 3 h] x W + b.
        state: [S, B, h].
        u: [S, h, 3 h] U.
        c: [S, 3 h] its biases.
    """
    width = state.shape[2]
    known = torch.baddbmm(c[:, None], state.to(u.dtype), u).float()
    (asked_gates, asked_candidate), (known_gates, known_candidate) = (
        torch.split(part, [2 * width, width], dim=2) for part in (asked, known)
    )
    reset, keep = torch.sigmoid(asked_gates + known_gates).chunk(2, dim=2)
    candidate = torch.tanh(asked_candidate + reset * known_candidate)
    return candidate + keep * (state - candidate)


def make_stack(
    config: OnPolicyConfig,
    count: int,
    shape: Shape,
    outputs: int,
    gain: float,
    names: Sequence[tuple[int | str, ...]],
) -> Stack:
    """Return a drawn stack of the configured networks; arguments as for `Stack` and `Stack.draw`.

    The shape is that of one input, `(inputs,)` for perceptrons.
    """
    if config.module is not None:
        stack: Stack = ModuleStack(config.module, count, shape, outputs)
    else:
        kind = Stack if config.memory == "none" else RecurrentStack
        stack = kind(count, math.prod(shape), config.hidden, outputs)
    stack.draw(gain, names)
    return stack
