"""All networks of one role, such as all actors, computed by one call.

An update off policy has dozens of networks, each so small that calling it costs more than computing it. So the networks
of a role are one module: a `Stack` for each type, whose parameters lie one after another in one vector.

    output = stacks(inputs)          # differentiable by the parameters
    output = stacks(inputs, change)  # differentiable by what is added to some inputs of each network

On processor cores perceptrons are computed by compiled kernels (`eia_sec.learner.networks.compiled`), which take
half the time of torch's products (`python -m research.benchmarks.kernels`). Elsewhere each stack computes itself.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from eia_sec.learner.networks.compiled import CompiledNetworks, outputs, parameter_room
from eia_sec.learner.networks.stack import Stack


@dataclass(frozen=True)
class Changes:
    """Which inputs of a stack's networks `change` is added to: of a critic, its agent's own action.

    Attributes:
        start: where the stack's part starts in `change`.
        first: the first network's first such input.
        step: increase of that index from network to network.
        size: how many inputs.
        shared: whether one part [rows, size] is added for all networks, or one each, [count, rows, size].
    """

    start: int
    first: int
    step: int
    size: int
    shared: bool = False

    def columns(self, count: int, device: torch.device) -> Tensor:
        """Return the inputs of each network, [count, size]."""
        first = self.first + self.step * torch.arange(count, device=device)
        return first[:, None] + torch.arange(self.size, device=device)


@dataclass(frozen=True)
class Shape:
    """The networks of one stack.

    Attributes:
        count: networks.
        inputs: numbers that each one sees.
        outputs: numbers that each one returns.
        rows: rows of data that each one works on.
        changes: which inputs a change is added to; None where there is never one.
    """

    count: int
    inputs: int
    outputs: int
    rows: int
    changes: Changes | None = None


class Stacks(nn.Module):
    """All networks of one role.

    Args:
        shapes: of each stack.
        hidden: width of the hidden layers.
        like: a tensor of the wanted device and type.
        cores: processor cores for the compiled kernels; 0 to compute by torch.

    Attributes:
        shapes: of each stack.
        flat: all parameters [P]: stack after stack, network after network, with zeros up to a cache line between them.
        stacks: the networks; their parameters are views of `flat`.
    """

    def __init__(self, shapes: Sequence[Shape], hidden: int, like: Tensor, *, cores: int) -> None:
        super().__init__()
        self.shapes, self._hidden, self._cores = tuple(shapes), hidden, cores
        self._sizes = [shape.count * parameter_room(shape, hidden) for shape in shapes]
        self.flat = nn.Parameter(like.new_zeros(sum(self._sizes)))
        self._constant = self.flat.detach()
        self.stacks = [
            Stack(shape.count, shape.inputs, hidden, shape.outputs, part)
            for shape, part in zip(shapes, self.parts(self._constant), strict=True)
        ]
        self._compiled: dict[int, CompiledNetworks] = {}

    def parts(self, flat: Tensor) -> list[Tensor]:
        """Return views [count, P] of each stack's part of a vector of all parameters, or of their gradients."""
        parts = torch.split(flat, self._sizes)
        return [part.view(shape.count, -1) for part, shape in zip(parts, self.shapes, strict=True)]

    def twin(self) -> "Stacks":
        """Return networks with the same parameters, which follow (`follow`) and are never differentiated by them."""
        other = Stacks(self.shapes, self._hidden, self._constant, cores=self._cores)
        other._constant.copy_(self._constant)
        # Both have the same buffers, of which only those of the newest pass count.
        other._compiled = self._compiled
        return other.requires_grad_(False)

    @torch.no_grad()
    def follow(self, other: "Stacks", rate: float) -> None:
        """Move the parameters towards another's, phi' <- rate phi + (1 - rate) phi'."""
        self.flat.lerp_(other.flat, rate)

    def forward(self, inputs: Sequence[Tensor], change: Tensor | None = None) -> Tensor:
        """Return all outputs, flat: stack by stack, network by network, row by row.

        Only the newest result of a role's networks and of their twins can be differentiated.

        Args:
            inputs: for each stack, or for the first ones alone, [count, rows, inputs], views of one buffer that stays.
                Networks that see the same rows have a first stride of 0. No gradient is taken by them.
            change: what is added to inputs as the shapes' `changes` say, flat. With it, the result is differentiable
                by the change alone.
        """
        flat, seen = self.flat if change is None else self._constant, len(inputs)
        if not self._cores:
            each = zip(self.stacks, self.shapes, inputs, self.parts(flat), strict=False)
            return torch.cat([_plain(*one, change).flatten() for one in each])
        if seen not in self._compiled:
            self._compiled[seen] = CompiledNetworks(self.shapes[:seen], self._hidden, flat, self._cores)
        return outputs(self._compiled[seen], inputs, flat, change)

    def norms(self) -> Tensor:
        """Return the Euclidean norm of each network's gradient, all stacks one after another."""
        return torch.cat([part.norm(dim=1) for part in self.parts(self._gradient())])

    def clip(self, limit: float) -> Tensor:
        """Scale each network's gradient to a norm of at most `limit`, if above 0; return the norms before."""
        norms = self.norms()
        if limit > 0.0:
            shares = torch.split(limit / norms.clamp_min(limit), [shape.count for shape in self.shapes])
            for part, share in zip(self.parts(self._gradient()), shares, strict=True):
                part.mul_(share[:, None])
        return norms

    def _gradient(self) -> Tensor:
        assert self.flat.grad is not None
        return self.flat.grad


def _plain(stack: Stack, shape: Shape, x: Tensor, flat: Tensor, change: Tensor | None) -> Tensor:
    """Return a stack's outputs [count, rows, outputs] by torch's own operations, on any device."""
    if change is None:
        return stack.outputs(x, flat)
    changes = shape.changes
    assert changes is not None
    count = 1 if changes.shared else shape.count
    part = change[changes.start :][: count * shape.rows * changes.size].view(count, shape.rows, changes.size)
    columns = changes.columns(shape.count, x.device)[:, None].expand(-1, shape.rows, -1)
    return stack.outputs(x.scatter_add(2, columns, part.expand(shape.count, -1, -1)), flat)
