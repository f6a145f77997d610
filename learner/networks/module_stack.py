"""Stacks whose networks are modules of a plug-in (`eia_sec.common.modules`)."""

import math
from collections.abc import Callable, Sequence
from typing import Any, Self

import torch
from torch import Tensor, nn

from eia_sec.common.config import NetworkConfig
from eia_sec.common.modules import FlatModule
from eia_sec.common.seeds import derive
from eia_sec.common.team import Shape
from eia_sec.learner.networks.sequences import Sequences
from eia_sec.learner.networks.stack import Stack


class ModuleStack(Stack):
    """S networks of a plug-in.

    Their last layers are not known. So they do not keep their function when running scales move, as perceptrons do.

    Args:
        options: the network's options.
        count: S.
        shape: of one input.
        outputs: numbers in an output.
    """

    def __init__(self, options: NetworkConfig, count: int, shape: Shape, outputs: int) -> None:
        nn.Module.__init__(self)
        self.count = count
        self._module = FlatModule(options, shape, outputs)
        self._vectors = len(shape) == 1
        self._shapes = self._module.shapes
        self._lengths = [math.prod(each) for each in self._shapes]
        self.size, self._room = self._module.size, []
        self.flat = nn.Parameter(torch.zeros(count, self.size))

    def _apply(self, fn: Callable[..., Any], recurse: bool = True) -> Self:
        """Move everything to another device, what the module holds besides its parameters included."""
        found: Self = super()._apply(fn, recurse)  # type: ignore[no-untyped-call]  # torch declares no types here
        self._module.to(self.flat.device)
        return found

    def draw(self, gain: float, names: Sequence[tuple[int | str, ...]]) -> None:
        """Let the plug-in draw the weights of all networks; it knows no gain.

        Args:
            gain: without meaning.
            names: parts of the name of each network's random stream.
        """
        for row, name in zip(self.flat.detach(), names, strict=True):
            row.copy_(torch.from_numpy(self._module.drawn(derive(*name))))

    def forward(self, x: Tensor, sequences: Sequences | None = None) -> Tensor:
        """Return the outputs [B, n, outputs] of each agent's network for x [B, n, o], where S is 1 or n."""
        if self.count == 1:
            return self._module(self.flat[0], x.flatten(0, 1)).view(*x.shape[:2], -1)
        own = zip(self.flat.unbind(0), x.unbind(1), strict=True)
        return torch.stack([self._module(row, seen) for row, seen in own], dim=1)

    @torch.no_grad()
    def rescale_inputs(self, shift: Tensor, scale: Tensor, flat: Tensor | None = None) -> None:
        """Let networks read x as they have read `shift + scale x`; images are read as they are."""
        if self._vectors:
            added, factor = (self.layers if flat is None else self.layers_of(flat))[:2]
            added += factor * shift
            factor *= scale

    def follow_inputs(self, shift: Tensor, scale: Tensor) -> None:
        """Read what has moved as it is."""

    def follow_outputs(self, shift: float, scale: float) -> None:
        """Learn what has moved."""
