"""The network module of both families: perceptrons with two hidden ReLU layers for all agents of a type.

A *stack* is one network that all agents of a type share, or one for each. The parameters of its S networks are one
tensor [S, P], so that an optimiser's step is a few large operations. Its layers are six views with a leading axis S, in
the order of `eia_sec.common.actors`: W1, b1, W2, b2, W3, b3.

On policy, a type's stack is called by itself. Off policy, all stacks of a role are computed by one call
(`eia_sec.learner.networks.stacks`), because one update takes dozens of small networks.
"""

import math
from collections.abc import Sequence
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from eia_sec.common.actors import layer_shapes
from eia_sec.common.gru import Memory
from eia_sec.common.seeds import stream
from eia_sec.common.team import Float32
from eia_sec.learner.networks.sequences import Sequences, Unroll


class Stack(nn.Module):
    """S networks of equal shape.

    Inputs of type bfloat16 are computed with in bfloat16, but for the last layer. Outputs have the parameters' type.

    Args:
        count: S.
        inputs: numbers in an input.
        hidden: width of the hidden layers.
        outputs: numbers in an output.
        place: the memory of the parameters, [S, P] or wider, of zeros beyond P; its owner trains them. Without it they
            are a parameter of this module, zeros of type float32.

    Attributes:
        count: S.
        size: P.
        flat: all parameters [S, P], as wide as `place`.
    """

    memory: ClassVar[Memory] = "none"

    def __init__(self, count: int, inputs: int, hidden: int, outputs: int, place: Tensor | None = None) -> None:
        super().__init__()
        self.count = count
        self._shapes = layer_shapes(inputs, hidden, outputs, self.memory)
        self._lengths = [math.prod(shape) for shape in self._shapes]
        self.size = sum(self._lengths)
        self.flat = nn.Parameter(torch.zeros(count, self.size)) if place is None else place
        self._room = [self.flat.shape[1] - self.size] if self.flat.shape[1] > self.size else []

    def layers_of(self, flat: Tensor) -> list[Tensor]:
        """Return views of the layers [S, ...] in a tensor [S, P]: the parameters, their gradient or a moment."""
        return self._shaped(torch.split(flat, [*self._lengths, *self._room], dim=1)[: len(self._lengths)])

    def _shaped(self, parts: Sequence[Tensor]) -> list[Tensor]:
        return [part.view(self.count, *shape) for part, shape in zip(parts, self._shapes, strict=True)]

    @property
    def layers(self) -> list[Tensor]:
        """All layers, to be read and written without gradients."""
        return self.layers_of(self.flat.detach())

    def layers_as(self, dtype: torch.dtype, flat: Tensor | None = None) -> list[Tensor]:
        """Return all layers for a pass: the last, W3 and b3, as they are, those before it as `dtype`."""
        before, last = self._lengths[:-2], self._lengths[-2:]
        # All are converted at once. A split's gradient is one concatenation, an index's would be a copy into zeros.
        parts = [sum(before), sum(last), *self._room]
        hidden, output, *_ = torch.split(self.flat if flat is None else flat, parts, dim=1)
        return self._shaped([*torch.split(hidden.to(dtype), before, dim=1), *torch.split(output, last, dim=1)])

    def draw(self, gain: float, names: Sequence[tuple[int | str, ...]]) -> None:
        """Draw the weights of all networks, orthogonal matrices; biases are left as they are.

        Args:
            gain: gain of the last layer; hidden layers have sqrt(2).
            names: parts of the name of each network's random stream.
        """
        for row, name in enumerate(names):
            self.initialise(row, stream(*name), gain)

    def initialise(self, row: int, generator: np.random.Generator, gain: float) -> None:
        """Draw the weights of one network.

        Args:
            row: number of the network.
            generator: where they are drawn.
            gain: gain of the last layer.
        """
        for index, layer_gain in ((0, math.sqrt(2.0)), (2, math.sqrt(2.0)), (4, gain)):
            layer = self.layers[index]
            layer[row] = torch.from_numpy(orthogonal(tuple(layer.shape[1:]), layer_gain, generator))

    def forward(self, x: Tensor, sequences: Sequences | None = None) -> Tensor:
        """Return the outputs of each agent's network.

        Args:
            x: [B, n, inputs] where S is 1 or n.
            sequences: how the rows follow one another, for networks with memory.

        Returns:
            [B, n, outputs].
        """
        if self.count == 1:
            return self.outputs(x.reshape(1, -1, x.shape[2])).view(x.shape[0], x.shape[1], -1)
        return self.outputs(x.transpose(0, 1)).transpose(0, 1)

    def outputs(self, x: Tensor, flat: Tensor | None = None) -> Tensor:
        """Return the outputs [S, R, outputs] of each network for rows of its own [S, R, inputs].

        Args:
            x: the rows.
            flat: parameters [S, P] in place of the stack's own.
        """
        w1, b1, w2, b2, w3, b3 = self.layers_as(x.dtype, flat)
        h = torch.relu_(affine(x, w1, b1))
        h = torch.relu_(affine(h, w2, b2))
        return affine(h.to(w3.dtype), w3, b3)

    def unroll(self, x: Tensor, sequences: Sequences) -> Unroll:
        """Return outputs and states, which only networks with memory have (`eia_sec.learner.networks.recurrent`)."""
        raise NotImplementedError("networks without memory have no states.")

    def export(self, flat: Tensor | None = None) -> Float32:
        """Return a copy of the parameters, [S, P] float32, in the order of `eia_sec.common.actors`.

        Args:
            flat: parameters [S, P] in place of the stack's own.
        """
        own = self.flat.detach() if flat is None else flat
        return own[:, : self.size].cpu().numpy().copy()

    @torch.no_grad()
    def rescale_inputs(self, shift: Tensor, scale: Tensor, flat: Tensor | None = None) -> None:
        """Change first layers W1 [S, i, h] and b1 [S, h], so that networks read x as they have read `shift + scale x`.

        Args:
            shift: [inputs].
            scale: [inputs].
            flat: parameters [S, P] to change in place of the stack's own.
        """
        weight, bias = (self.layers if flat is None else self.layers_of(flat))[:2]
        bias += torch.einsum("i,sih->sh", shift, weight)
        weight *= scale[:, None]

    @torch.no_grad()
    def rescale_outputs(self, shift: float, scale: float) -> None:
        """Change last layers W3 and b3, so that networks return `shift + scale y` in place of y."""
        weight, bias = self.layers[-2:]
        weight *= scale
        bias.mul_(scale).add_(shift)

    def follow_inputs(self, shift: Tensor, scale: Tensor) -> None:
        """Keep the function of networks that have learnt when their inputs move, see `rescale_inputs`."""
        self.rescale_inputs(shift, scale)

    def follow_outputs(self, shift: float, scale: float) -> None:
        """Keep the function of networks that have learnt when what they learn moves, see `rescale_outputs`."""
        self.rescale_outputs(shift, scale)

    @torch.no_grad()
    def load(self, flat: Float32) -> None:
        """Replace the parameters by [S, P] float32."""
        own = self.flat[:, : self.size]
        assert flat.shape == own.shape  # else `copy_` would repeat the rows that there are
        own.copy_(torch.from_numpy(np.ascontiguousarray(flat)))


def affine(x: Tensor, weights: Tensor, biases: Tensor) -> Tensor:
    """Return x W + b of S networks, [S, R, b], for x [S, R, a], W [S, a, b] and b [S, b]."""
    if len(weights) > 1:
        return torch.baddbmm(biases[:, None], x, weights)
    return torch.addmm(biases.squeeze(0), x.squeeze(0), weights.squeeze(0)).unsqueeze(0)


def orthogonal(shape: tuple[int, ...], gain: float, generator: np.random.Generator) -> Float32:
    """Return a matrix whose rows or columns are orthonormal, times a gain (Saxe et al. 2014)."""
    rows, columns = shape
    square = generator.standard_normal((max(rows, columns), min(rows, columns)))
    q, r = np.linalg.qr(square)
    q *= np.sign(np.diag(r))
    found: Float32 = (gain * (q if rows >= columns else q.T)).astype(np.float32)
    return found
