"""Stacked perceptrons with written-out gradients: many small networks as a few batched matrix products.

`Networks` lays out the parameters of networks of one role (all actors, say) in one flat vector, layer by layer and
type by type inside a layer. A layer of n networks is one tensor [n, 1 + fan_in, fan_out] whose row 0 is the bias, and
inputs carry a leading one, so a product with the tensor adds the bias. Types whose layer has the same shape are
neighbours and are multiplied together; the hidden layer of all types is one product.

Forward, for inputs x with the leading one:  h1 = relu(x W1),  h2 = relu([1 h1] W2),  y = [1 h2] W3.

`StackedPass` computes this with torch on any device; `eia_sec.learner.networks.compiled_pass` does the same on
processor cores, network by network, so that a network's numbers stay in the cache.
"""

import copy
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import torch
from torch import Tensor

from eia_sec.common.actors import layer_shapes


@dataclass(frozen=True)
class Stack:
    """The networks of one type.

    Attributes:
        count: networks.
        inputs: numbers that each one sees, without the leading one.
        outputs: numbers that each one returns.
        rows: rows of data that each one works on.
        action: for critics, index of the first network's own action among its inputs, the leading one included.
        action_step: increase of that index from network to network.
        action_size: numbers in the own action; 0 for actors.
    """

    count: int
    inputs: int
    outputs: int
    rows: int
    action: int = 0
    action_step: int = 0
    action_size: int = 0


@dataclass(frozen=True)
class Block:
    """Neighbouring networks whose layer is computed as one product.

    Attributes:
        count: networks.
        rows: rows of data of each.
        fan_in: inputs of the layer, without the leading one.
        fan_out: outputs of the layer.
        parameter: where the layer's parameters start in the flat vector.
        row: where the networks' rows start among all rows of the networks.
    """

    count: int
    rows: int
    fan_in: int
    fan_out: int
    parameter: int
    row: int

    @property
    def size(self) -> int:
        """Parameters of the layer of one network."""
        return (1 + self.fan_in) * self.fan_out

    def weights(self, flat: Tensor) -> Tensor:
        """Return the layer [count, 1 + fan_in, fan_out] as a view of the flat vector."""
        part = flat[self.parameter : self.parameter + self.count * self.size]
        return part.view(self.count, 1 + self.fan_in, self.fan_out)

    def data(self, buffer: Tensor) -> Tensor:
        """Return these networks' rows [count, rows, width] as a view of a buffer [all rows, width]."""
        return buffer[self.row : self.row + self.count * self.rows].view(self.count, self.rows, -1)


@dataclass(frozen=True)
class Parameters:
    """A flat vector of parameters, or of a gradient, and its views.

    Attributes:
        flat: [P].
        first, second, head: for each layer, one tensor [count, 1 + fan_in, fan_out] for each block.
        own: for critics, each type's rows of the first layer that take the own action, [count, action_size, hidden].
    """

    flat: Tensor
    first: list[Tensor]
    second: list[Tensor]
    head: list[Tensor]
    own: list[Tensor]


class Networks:
    """The layout of all networks of one role.

    Args:
        stacks: the networks of each type.
        hidden: width of both hidden layers.
    """

    def __init__(self, stacks: Sequence[Stack], hidden: int) -> None:
        self.stacks, self.hidden = tuple(stacks), hidden
        self.typed: list[list[Block]] = []
        self.size = 0
        for layer in range(3):
            self.typed.append(self._lay_out(layer))
        self._count()

    def _count(self) -> None:
        self.rows = sum(stack.count * stack.rows for stack in self.stacks)
        self.outputs = sum(stack.count * stack.rows * stack.outputs for stack in self.stacks)
        self.blocks = [self.typed[0], _joined(self.typed[1]), _joined(self.typed[2])]

    def part(self, stacks: int) -> "Networks":
        """Return the layout of the first `stacks` stacks alone, at the same places of the same flat vector."""
        part = copy.copy(self)
        part.stacks, part.typed = self.stacks[:stacks], [blocks[:stacks] for blocks in self.typed]
        part._count()
        return part

    def _lay_out(self, layer: int) -> list[Block]:
        blocks, row = [], 0
        for stack in self.stacks:
            fans = (stack.inputs, self.hidden, self.hidden, stack.outputs)
            block = Block(stack.count, stack.rows, fans[layer], fans[layer + 1], self.size, row)
            blocks.append(block)
            self.size += stack.count * block.size
            row += stack.count * stack.rows
        return blocks

    def parameters(self, flat: Tensor) -> Parameters:
        """Return the layers as views of a flat vector [size]."""
        first, second, head = ([block.weights(flat) for block in blocks] for blocks in self.blocks)
        own = [_own(s, block.weights(flat)) for s, block in zip(self.stacks, self.typed[0], strict=True)]
        return Parameters(flat, first, second, head, own)

    def layers_of(self, flat: Tensor, kind: int) -> list[Tensor]:
        """Return the layers [count, 1 + fan_in, fan_out] of one stack's networks as views of a flat vector [size]."""
        return [blocks[kind].weights(flat) for blocks in self.typed]

    def load(self, flat: Tensor, kind: int, parameters: Tensor) -> None:
        """Write one stack's parameters, [count, P] in the order of `eia_sec.common.actors`, into a flat vector."""
        stack = self.stacks[kind]
        shapes = layer_shapes(stack.inputs, self.hidden, stack.outputs)
        pieces = torch.split(parameters.to(flat), [int(torch.Size(shape).numel()) for shape in shapes], dim=1)
        for layer, weight, bias in zip(self.layers_of(flat, kind), pieces[::2], pieces[1::2], strict=True):
            layer[:, 1:].copy_(weight.reshape(layer[:, 1:].shape))
            layer[:, 0].copy_(bias)

    def export(self, flat: Tensor, kind: int) -> Tensor:
        """Return a copy of one stack's parameters as [count, P] in the order of `eia_sec.common.actors`."""
        pieces = []
        for layer in self.layers_of(flat, kind):
            pieces += [layer[:, 1:].flatten(1), layer[:, 0]]
        return torch.cat(pieces, dim=1)

    def norms(self, flat: Tensor) -> Tensor:
        """Return the Euclidean norm of each network's part of a flat vector, all stacks one after another."""
        return torch.cat([self.export(flat, kind).norm(dim=1) for kind in range(len(self.stacks))])

    def segments(self) -> Tensor:
        """Return, for each number of a flat vector, which of the networks it belongs to: int64 [size]."""
        parts = []
        for blocks in self.typed:
            first = 0
            for block in blocks:
                parts.append(torch.arange(first, first + block.count).repeat_interleave(block.size))
                first += block.count
        return torch.cat(parts)


def _own(stack: Stack, first: Tensor) -> Tensor:
    """Return the rows of the own action as one view; each network's start `action_step` rows after the last one's."""
    network, row, column = first.stride()
    return first.as_strided(
        (stack.count, stack.action_size, first.shape[2]),
        (network + stack.action_step * row, row, column),
        first.storage_offset() + stack.action * row,
    )


def _joined(blocks: list[Block]) -> list[Block]:
    result = []
    for _, run in itertools.groupby(blocks, key=lambda block: (block.rows, block.fan_in, block.fan_out)):
        members = list(run)
        first = members[0]
        count = sum(block.count for block in members)
        result.append(Block(count, first.rows, first.fan_in, first.fan_out, first.parameter, first.row))
    return result


class Forward(NamedTuple):
    """The result of a forward pass, which the gradients take.

    Attributes:
        parameters: the parameters used.
        inputs: for each stack [count, rows, 1 + fan_in].
        output: all outputs, flat: stack by stack, network by network, row by row; valid until the next forward pass.
        number: its number among the forward passes of its `Pass`.
    """

    parameters: Parameters
    inputs: Sequence[Tensor]
    output: Tensor
    number: int


class Pass(Protocol):
    """Forward pass of one layout and its gradients, in buffers that are allocated once.

    The activations of the newest forward pass are kept for its gradients. A gradient of an older one raises
    RuntimeError.
    """

    def forward(self, parameters: Parameters, inputs: Sequence[Tensor], delta: Sequence[Tensor] = ()) -> Forward:
        """Run the networks.

        Args:
            parameters: of all networks.
            inputs: for each stack [count, rows, 1 + fan_in], all of them views of one buffer. Networks that see the
                same rows have a first stride of 0.
            delta: for each stack [count, rows, action_size], added to the own actions in `inputs`; empty for nothing.
        """
        ...

    def parameter_gradient(self, forward: Forward, upstream: Tensor, into: Parameters) -> None:
        """Write the gradient of sum(upstream * output) by all parameters; `upstream` is flat, as `output`."""
        ...

    def action_gradient(self, forward: Forward, upstream: Tensor, into: Sequence[Tensor]) -> None:
        """Add to `into` the gradient of sum(upstream * output) by the own actions, for scalar networks.

        `into` has the shapes of `delta`. Gradients of networks that share a tensor there add up.
        """
        ...


class ForwardCounter:
    """Counts forward passes, so that the gradient of an overwritten one is refused."""

    def __init__(self) -> None:
        self.newest = 0

    def next(self) -> int:
        """Return the number of the forward pass that begins."""
        self.newest += 1
        return self.newest

    def check(self, forward: Forward) -> None:
        """Raise RuntimeError unless no other forward pass has followed."""
        if forward.number != self.newest:
            raise RuntimeError("a later forward pass has overwritten the activations that this gradient needs.")


class StackedPass:
    """A `Pass` that uses torch's batched products, on any device."""

    def __init__(self, networks: Networks, like: Tensor) -> None:
        self.networks = networks
        self._counter = ForwardCounter()
        hidden, rows = networks.hidden, networks.rows
        self._h1, self._h2 = like.new_ones(rows, 1 + hidden), like.new_ones(rows, 1 + hidden)
        self._z, self._dh = like.new_empty(rows, hidden), like.new_empty(rows, hidden)
        _, second, head = networks.blocks
        self._z1, self._z2, self._z3 = ([b.data(self._z) for b in blocks] for blocks in networks.blocks)
        self._matrices = [like.new_empty(block.count, hidden, hidden) for block in second]
        self._h1_second = [block.data(self._h1) for block in second]
        self._h2_head = [block.data(self._h2) for block in head]
        self._dh_second = [block.data(self._dh) for block in second]
        self._dh_head = [block.data(self._dh) for block in head]
        self.scalar = all(stack.outputs == 1 for stack in networks.stacks)
        self._output = like.new_empty(networks.outputs)
        starts = [0, *itertools.accumulate(b.count * b.rows * b.fan_out for b in head)]
        self._slots = [slice(a, b) for a, b in itertools.pairwise(starts)]
        self._outputs = self._split(self._output)

    def _split(self, flat: Tensor) -> list[Tensor]:
        """View a flat [outputs] tensor as [n, 1, rows] for scalar networks, else [n, rows, outputs], for each block."""
        return [
            flat[slot].view(b.count, 1, b.rows) if self.scalar else flat[slot].view(b.count, b.rows, b.fan_out)
            for b, slot in zip(self.networks.blocks[2], self._slots, strict=True)
        ]

    def forward(self, parameters: Parameters, inputs: Sequence[Tensor], delta: Sequence[Tensor] = ()) -> Forward:
        """See `Pass`."""
        for x, w, z in zip(inputs, parameters.first, self._z1, strict=True):
            torch.bmm(x, w, out=z)
        if delta:
            for d, w, z in zip(delta, parameters.own, self._z1, strict=True):
                z.baddbmm_(d, w)
        torch.clamp_min(self._z, 0.0, out=self._h1[:, 1:])
        for h, w, z in zip(self._h1_second, parameters.second, self._z2, strict=True):
            torch.bmm(h, w, out=z)
        torch.clamp_min(self._z, 0.0, out=self._h2[:, 1:])
        for h, w, y in zip(self._h2_head, parameters.head, self._outputs, strict=True):
            if self.scalar:
                torch.bmm(w.transpose(1, 2), h.transpose(1, 2), out=y)
            else:
                torch.bmm(h, w, out=y)
        return Forward(parameters, inputs, self._output, self._counter.next())

    def parameter_gradient(self, forward: Forward, upstream: Tensor, into: Parameters) -> None:
        """See `Pass`."""
        self._counter.check(forward)
        parameters, inputs = forward.parameters, forward.inputs
        for g, h, out in zip(self._split(upstream), self._h2_head, into.head, strict=True):
            if self.scalar:
                torch.bmm(g, h, out=out.transpose(1, 2))
            else:
                torch.bmm(h.transpose(1, 2), g, out=out)
        self._through_head(parameters, upstream)
        for h, z, out in zip(self._h1_second, self._z2, into.second, strict=True):
            torch.bmm(h.transpose(1, 2), z, out=out)
        self._through_hidden(parameters)
        for x, z, out in zip(inputs, self._z1, into.first, strict=True):
            torch.bmm(x.transpose(1, 2), z, out=out)

    def _through_head(self, parameters: Parameters, upstream: Tensor) -> None:
        """Write the gradient by the hidden layer's sums into z."""
        for g, w, z, dh in zip(self._split(upstream), parameters.head, self._z3, self._dh_head, strict=True):
            if self.scalar:
                torch.mul(g.transpose(1, 2), w[:, 1:].transpose(1, 2), out=z)
            else:
                torch.bmm(g, w[:, 1:].transpose(1, 2), out=dh)
        _through_relu(self._z if self.scalar else self._dh, self._h2[:, 1:], self._z)

    def _through_hidden(self, parameters: Parameters) -> None:
        """Write the gradient by the first layer's sums into z."""
        for z, w, matrix, dh in zip(self._z2, parameters.second, self._matrices, self._dh_second, strict=True):
            torch.bmm(z, matrix.copy_(w[:, 1:]).transpose(1, 2), out=dh)
        _through_relu(self._dh, self._h1[:, 1:], self._z)

    def action_gradient(self, forward: Forward, upstream: Tensor, into: Sequence[Tensor]) -> None:
        """See `Pass`."""
        self._counter.check(forward)
        parameters = forward.parameters
        self._through_head(parameters, upstream)
        self._through_hidden(parameters)
        for z, w, out in zip(self._z1, parameters.own, into, strict=True):
            if out.stride(0) == 0 and out.shape[0] > 1:  # one sum for all networks of the stack
                out[0].add_(torch.bmm(z, w.transpose(1, 2)).sum(dim=0))
            else:
                out.baddbmm_(z, w.transpose(1, 2))


def _through_relu(gradient: Tensor, activation: Tensor, out: Tensor) -> None:
    """Write the gradient where the activation is above 0, and 0 elsewhere."""
    torch.ops.aten.threshold_backward.grad_input(gradient, activation, 0.0, grad_input=out)
