"""Stacked perceptrons with written-out gradients: many small networks as a few batched matrix products.

A `Bank` lays out the parameters of networks of one role (all actors, say) in one flat vector, layer by layer and type
by type inside a layer. A layer of n networks is one tensor [n, 1 + fan_in, fan_out] whose row 0 is the bias, and
activations carry a leading column of ones, so a product with the tensor adds the bias and a product with the transposed
activations yields the bias gradient too. Types whose layer has the same shape are neighbours and are multiplied
together; the hidden layer of all types is one product.

Forward, for inputs x with the leading one:  h1 = relu(x W1),  h2 = relu([1 h1] W2),  y = [1 h2] W3.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from common.actors import layer_shapes


@dataclass(frozen=True)
class Stack:
    """The networks of one type in a bank.

    Attributes:
        count: networks.
        inputs: numbers that each one sees, without the leading one.
        outputs: numbers that each one returns.
        rows: rows of data that each one works on.
        shared: whether all of them see the same rows; their first layers then stand side by side in one matrix.
    """

    count: int
    inputs: int
    outputs: int
    rows: int
    shared: bool = False


@dataclass(frozen=True)
class Block:
    """Neighbouring networks whose layer is computed as one product.

    Attributes:
        count: networks.
        rows: rows of data of each.
        fan_in: inputs of the layer, without the leading one.
        fan_out: outputs of the layer.
        parameter: where the layer's parameters start in the flat vector.
        row: where the networks' rows start among all rows of the bank.
    """

    count: int
    rows: int
    fan_in: int
    fan_out: int
    parameter: int
    row: int

    def weights(self, flat: Tensor) -> Tensor:
        """Return the layer [count, 1 + fan_in, fan_out] as a view of the flat vector."""
        size = self.count * (1 + self.fan_in) * self.fan_out
        return flat[self.parameter : self.parameter + size].view(self.count, 1 + self.fan_in, self.fan_out)

    def data(self, buffer: Tensor) -> Tensor:
        """Return these networks' rows [count, rows, width] as a view of a buffer [all rows, width]."""
        return buffer[self.row : self.row + self.count * self.rows].view(self.count, self.rows, -1)

    def sums(self, buffer: Tensor, hidden: int) -> Tensor:
        """Return the layer's sums [count, rows, fan_out] as a view of a buffer [all rows, hidden]."""
        size = self.count * self.rows * self.fan_out // hidden
        return buffer[self.row : self.row + size].view(self.count, self.rows, self.fan_out)


@dataclass(frozen=True)
class Layers:
    """Views of one flat vector: for each layer, one tensor [count, 1 + fan_in, fan_out] for each block."""

    first: list[Tensor]
    second: list[Tensor]
    head: list[Tensor]


class Bank:
    """The layout of all networks of one role.

    Args:
        stacks: the networks of each type.
        hidden: width of both hidden layers.
        join_inputs: whether types of equal input size share one product in the first layer; their inputs must then
            be neighbours in one buffer.
    """

    def __init__(self, stacks: Sequence[Stack], hidden: int, *, join_inputs: bool = False) -> None:
        self.stacks, self.hidden = tuple(stacks), hidden
        self.rows = sum(stack.count * stack.rows for stack in stacks)
        self.typed: list[list[Block]] = []
        self.size = 0
        for layer in range(3):
            self.typed.append(self._lay_out(layer))
        self.blocks = [_joined(blocks) if layer or join_inputs else blocks for layer, blocks in enumerate(self.typed)]

    def _lay_out(self, layer: int) -> list[Block]:
        blocks, row = [], 0
        for stack in self.stacks:
            fans = (stack.inputs, self.hidden, self.hidden, stack.outputs)
            beside = stack.count if stack.shared and layer == 0 else 1
            fan_in, fan_out = fans[layer], fans[layer + 1] * beside
            blocks.append(Block(stack.count // beside, stack.rows, fan_in, fan_out, self.size, row))
            self.size += stack.count * (1 + fan_in) * fans[layer + 1]
            row += stack.count * stack.rows
        return blocks

    def layers(self, flat: Tensor) -> Layers:
        """Return the layers as views of a flat vector [size]."""
        return Layers(*([block.weights(flat) for block in blocks] for blocks in self.blocks))

    def layers_of(self, flat: Tensor, kind: int) -> list[Tensor]:
        """Return the layers [count, 1 + fan_in, fan_out] of one type's networks as views of a flat vector [size]."""
        first, *rest = (blocks[kind].weights(flat) for blocks in self.typed)
        if self.stacks[kind].shared:
            first = torch.unflatten(first[0], 1, (self.stacks[kind].count, self.hidden)).transpose(0, 1)
        return [first, *rest]

    def load(self, flat: Tensor, kind: int, parameters: Tensor) -> None:
        """Write one type's parameters, [count, P] in the order of `common.actors`, into a flat vector."""
        stack = self.stacks[kind]
        shapes = layer_shapes(stack.inputs, self.hidden, stack.outputs)
        pieces = torch.split(parameters.to(flat), [_length(shape) for shape in shapes], dim=1)
        for layer, weight, bias in zip(self.layers_of(flat, kind), pieces[::2], pieces[1::2], strict=True):
            layer[:, 1:].copy_(weight.reshape(layer[:, 1:].shape))
            layer[:, 0].copy_(bias)

    def export(self, flat: Tensor, kind: int) -> Tensor:
        """Return a copy of one type's parameters as [count, P] in the order of `common.actors`."""
        pieces = []
        for layer in self.layers_of(flat, kind):
            pieces += [layer[:, 1:].flatten(1), layer[:, 0]]
        return torch.cat(pieces, dim=1)


def _length(shape: tuple[int, ...]) -> int:
    return int(torch.Size(shape).numel())


def _joined(blocks: list[Block]) -> list[Block]:
    result = []
    for _, run in itertools.groupby(blocks, key=lambda block: (block.rows, block.fan_in, block.fan_out)):
        members = list(run)
        first = members[0]
        count = sum(block.count for block in members)
        result.append(Block(count, first.rows, first.fan_in, first.fan_out, first.parameter, first.row))
    return result


class Workspace:
    """Memory for the activations of one pass at a time; passes that share it take turns and find it in the cache.

    Args:
        rows: most rows of a pass.
        hidden: width of the hidden layers.
        like: a tensor of the wanted device and type.
    """

    def __init__(self, rows: int, hidden: int, like: Tensor) -> None:
        self.h1 = like.new_ones(rows, 1 + hidden)
        self.h2 = like.new_ones(rows, 1 + hidden)
        self.sums = like.new_empty(rows, hidden)
        self.gradient = like.new_empty(rows, hidden)


class Pass:
    """One bank's forward pass and its gradients, in buffers that are allocated once.

    Args:
        bank: the layout.
        workspace: memory for the activations.
    """

    def __init__(self, bank: Bank, workspace: Workspace) -> None:
        self.bank = bank
        hidden, rows = bank.hidden, bank.rows
        shared = any(stack.shared for stack in bank.stacks)
        self._h1, self._h2 = workspace.h1[:rows], workspace.h2[:rows]
        self._z, self._dh = workspace.sums[:rows], workspace.gradient[:rows]
        like = self._z
        first, second, head = bank.blocks
        self._z1 = [block.sums(self._z, hidden) for block in first]
        self._z1_typed = [block.sums(self._z, hidden) for block in bank.typed[0]]
        self._z2, self._z3 = ([b.data(self._z) for b in blocks] for blocks in (second, head))
        self._units = [self._per_network(kind) for kind in range(len(bank.stacks))] if shared else [self._whole()]
        self._matrices = [like.new_empty(block.count, hidden, hidden) for block in second]
        self._h1_second = [block.data(self._h1) for block in second]
        self._h2_head = [block.data(self._h2) for block in head]
        self._dh_second = [block.data(self._dh) for block in second]
        self._dh_head = [block.data(self._dh) for block in head]
        self.scalar = all(stack.outputs == 1 for stack in bank.stacks)
        sizes = [stack.count * stack.rows * stack.outputs for stack in bank.stacks]
        self.output = like.new_empty(sum(sizes))
        """All outputs, flat: type by type, network by network, row by row."""
        starts = [0, *itertools.accumulate(b.count * b.rows * b.fan_out for b in head)]
        self._slots = [slice(a, b) for a, b in itertools.pairwise(starts)]
        self._outputs = self._split(self.output)

    def _whole(self) -> tuple[Tensor, Tensor, Tensor]:
        """Return the first layer's sums, h1 and the gradient by h1, row by row alike."""
        return self._z, self._h1[:, 1:], self._dh

    def _per_network(self, kind: int) -> tuple[Tensor, Tensor, Tensor]:
        """Return the same for one type whose networks' sums stand side by side, as [count, rows, hidden]."""
        stack, block = self.bank.stacks[kind], self.bank.typed[1][kind]
        sums = torch.unflatten(self._z1_typed[kind][0], 1, (stack.count, self.bank.hidden)).transpose(0, 1)
        return sums, block.data(self._h1)[:, :, 1:], block.data(self._dh)

    def _split(self, flat: Tensor) -> list[Tensor]:
        """View a flat [outputs] tensor as [n, 1, rows] for scalar networks, else [n, rows, outputs], for each block."""
        return [
            flat[slot].view(b.count, 1, b.rows) if self.scalar else flat[slot].view(b.count, b.rows, b.fan_out)
            for b, slot in zip(self.bank.blocks[2], self._slots, strict=True)
        ]

    def hidden_layers(self, layers: Layers, inputs: Sequence[Tensor]) -> None:
        """Compute h1 and h2 from inputs [count, rows, 1 + fan_in], one tensor for each block of the first layer."""
        for x, w, z in zip(inputs, layers.first, self._z1, strict=True):
            torch.bmm(x, w, out=z)
        for sums, h1, _ in self._units:
            torch.clamp_min(sums, 0.0, out=h1)
        for h, w, z in zip(self._h1_second, layers.second, self._z2, strict=True):
            torch.bmm(h, w, out=z)
        torch.clamp_min(self._z, 0.0, out=self._h2[:, 1:])

    def head(self, layers: Layers) -> Tensor:
        """Compute and return `output` from h2."""
        for h, w, y in zip(self._h2_head, layers.head, self._outputs, strict=True):
            if self.scalar:
                torch.bmm(w.transpose(1, 2), h.transpose(1, 2), out=y)
            else:
                torch.bmm(h, w, out=y)
        return self.output

    def forward(self, layers: Layers, inputs: Sequence[Tensor]) -> Tensor:
        """Return `output` for inputs [count, rows, 1 + fan_in], one tensor for each block of the first layer."""
        self.hidden_layers(layers, inputs)
        return self.head(layers)

    def parameter_gradient(self, layers: Layers, inputs: Sequence[Tensor], upstream: Tensor, into: Layers) -> None:
        """Write the gradient of sum(upstream * output) by all parameters.

        Args:
            layers: the parameters that the forward pass used.
            inputs: its inputs.
            upstream: flat, as `output`.
            into: where the gradient goes.
        """
        for g, h, w, z, dh, out in zip(
            self._split(upstream), self._h2_head, layers.head, self._z3, self._dh_head, into.head, strict=True
        ):
            if self.scalar:
                torch.bmm(g, h, out=out.transpose(1, 2))
                torch.mul(g.transpose(1, 2), w[:, 1:].transpose(1, 2), out=z)
            else:
                torch.bmm(h.transpose(1, 2), g, out=out)
                torch.bmm(g, w[:, 1:].transpose(1, 2), out=dh)
        _through_relu(self._z if self.scalar else self._dh, self._h2[:, 1:], self._z)
        for h, z, out in zip(self._h1_second, self._z2, into.second, strict=True):
            torch.bmm(h.transpose(1, 2), z, out=out)
        self._through_hidden(layers)
        for x, z, out in zip(inputs, self._z1, into.first, strict=True):
            torch.bmm(x.transpose(1, 2), z, out=out)

    def _through_hidden(self, layers: Layers) -> None:
        for z, w, matrix, dh in zip(self._z2, layers.second, self._matrices, self._dh_second, strict=True):
            torch.bmm(z, matrix.copy_(w[:, 1:]).transpose(1, 2), out=dh)
        for sums, h1, gradient in self._units:
            _through_relu(gradient, h1, sums)

    def first_layer_gradient(self, layers: Layers, scale: float) -> list[Tensor]:
        """Return the gradient of scale * sum(output) by the first layer's sums, for scalar networks.

        Returns:
            one view for each type, [count, rows, hidden], or [1, rows, count * hidden] of networks that share their
            rows; valid until the next forward pass.
        """
        for h, w, z in zip(self._h2_head, layers.head, self._z3, strict=True):
            _through_relu((w[:, 1:].transpose(1, 2) * scale).expand_as(z), h[:, :, 1:], z)
        self._through_hidden(layers)
        return self._z1_typed


def _through_relu(gradient: Tensor, activation: Tensor, out: Tensor) -> None:
    """Write the gradient where the activation is above 0, and 0 elsewhere."""
    torch.ops.aten.threshold_backward.grad_input(gradient, activation, 0.0, grad_input=out)
