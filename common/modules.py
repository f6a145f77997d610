"""Networks of plug-ins: how their torch modules are made and called.

This module loads torch; whoever needs no network of a plug-in does not import it.

    module = Cnn(shape, outputs, options)     the class that the plug-in names, `options` of the class it names
    z = module(x)                             x [B, *shape] float32, z [B, outputs]

`shape` is (o,) of a vector, or (channels, height, width) of an image, whose bytes are scaled to 0..1. Vectors hold
action masks, images come without. `outputs` are an actor's, see `eia_sec.common.actors`, or those of a value function.
A module is always in evaluation mode. `eia_sec.common.module_trials` says what is refused before a run.

All that a module learns are its parameters. They are one row of numbers, so that they travel, are stored and are
blended as those of perceptrons are. Its order is that of `named_parameters`. Before them, a network that reads vectors
has what is added to each number of an observation and what it is multiplied by first: 2 o numbers, which are not
trained (`eia_sec.learner.on_policy.normalisation`).
"""

import math
import random
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import Final, cast

import numpy as np
import torch
from torch import Tensor, nn
from torch.func import functional_call

from eia_sec.common import plugins
from eia_sec.common.config import NetworkConfig
from eia_sec.common.errors import PluginError
from eia_sec.common.team import Float32, Shape

WHITE: Final = 255.0
"""Largest byte of an image."""
KEPT: Final = 32
"""Modules that a thread keeps."""
_OF_THREAD: Final = threading.local()
_DRAWING: Final = threading.RLock()


class FlatModule:
    """A module whose parameters come from outside, as one row of numbers.

    Args:
        options: the network's options, whose name says which one it is.
        shape: of one input.
        outputs: numbers that it returns.
        device: torch device of what it holds besides parameters; "meta" for shapes alone, where only lazy layers make
            a call necessary.
        seed: of whatever the module draws while it is made. Parameters come from outside; anything else that it draws
            is thus the same in every process.

    Attributes:
        shapes: of the row's parts: shift and scale of inputs that are vectors, then the parameters.
        size: P, length of the row.

    Raises:
        PluginError: the plug-in is not loaded, or its module cannot be made or used.
    """

    def __init__(self, options: NetworkConfig, shape: Shape, outputs: int, device: str = "cpu", seed: int = 0) -> None:
        self._options, self._shape, self._outputs = options, shape, outputs
        with seeded(seed):
            self.what, self._module = _made(options, shape, outputs, device)
            if device != "meta" or any(map(nn.parameter.is_lazy, self._module.parameters())):
                self._tried(device)
        named = dict(self._module.named_parameters())
        _require_trainable(self.what, self._module, named)
        self._names = list(named)
        self._affine = [] if len(shape) > 1 else [shape, shape]
        self.shapes: list[Shape] = [*self._affine, *(tuple(each.shape) for each in named.values())]
        self._lengths = [math.prod(each) for each in self.shapes]
        self.size = sum(self._lengths)

    def to(self, device: torch.device) -> None:
        """Move what the module holds besides parameters."""
        self._module.to(device)

    def drawn(self, seed: int) -> Float32:
        """Return fresh parameters [P]; equal seeds give equal ones."""
        fresh = FlatModule(self._options, self._shape, self._outputs, seed=seed)
        if fresh.shapes != self.shapes:
            raise PluginError(f"{self.what} has other parameters each time it is made.")
        parts = [np.ravel(parameter.detach().numpy()) for parameter in fresh._module.parameters()]
        identity = [np.zeros(self._shape, np.float32), np.ones(self._shape, np.float32)] if self._affine else []
        return np.concatenate([*identity, *parts]).astype(np.float32)

    def __call__(self, flat: Tensor, x: Tensor) -> Tensor:
        """Return the outputs [B, outputs] float32.

        Args:
            flat: [P] the row.
            x: [B, o] observations: a vector, or an image row by row, with anything behind it.

        Raises:
            PluginError: the module raised an exception, or returned something else.
        """
        return self._result(self.named(flat), self.inputs(self.affine(flat), x))

    def named(self, flat: Tensor) -> dict[str, Tensor]:
        """Return views of the parameters in a row [P] by their names in the module."""
        return dict(zip(self._names, self._parts(flat)[len(self._affine) :], strict=True))

    def buffers(self) -> dict[str, Tensor]:
        """Return what the module holds besides parameters, by name."""
        return dict(self._module.named_buffers())

    def affine(self, flat: Tensor) -> list[Tensor]:
        """Return shift and scale of inputs that are vectors, [o] each; nothing for images."""
        return [part.detach() for part in self._parts(flat)[: len(self._affine)]]

    def filled(self, flat: Tensor) -> nn.Module:
        """Return a module of its own with the parameters of a row [P]."""
        found = FlatModule(self._options, self._shape, self._outputs)._module
        found.load_state_dict(self.named(flat), strict=False)
        return found

    def _parts(self, flat: Tensor) -> list[Tensor]:
        return [part.view(shape) for part, shape in zip(flat.split(self._lengths), self.shapes, strict=True)]

    def inputs(self, affine: list[Tensor], x: Tensor) -> Tensor:
        """Return observations [B, o] as the module reads them, [B, *shape] float32.

        Args:
            affine: see `affine`.
            x: a vector, or an image row by row, with anything behind it.
        """
        if affine:
            shift, scale = affine
            return x.float() * scale + shift
        channels, height, width = self._shape
        image = x[:, : math.prod(self._shape)].view(-1, height, width, channels)
        pixels = image.permute(0, 3, 1, 2).to(torch.float32, memory_format=torch.contiguous_format, copy=True)
        return pixels.div_(WHITE)

    def _result(self, parameters: dict[str, Tensor], x: Tensor) -> Tensor:
        forward = f"{self.what}.forward"
        try:
            found = functional_call(self._module, parameters, (x,))
        except Exception as error:  # a user's module may raise anything
            raise PluginError(f"{forward} raised {type(error).__name__}: {_brief(error)}") from error
        wanted = len(x), self._outputs
        if not isinstance(found, Tensor) or found.shape != wanted:
            shown = list(found.shape) if isinstance(found, Tensor) else f"a {type(found).__name__}"
            raise PluginError(
                f"{forward} returned {shown} for {list(x.shape)}, and must return a tensor {list(wanted)}: a row of "
                f"{self._outputs} outputs for each input."
            )
        return found.float()

    @torch.no_grad()
    def _tried(self, device: str) -> None:
        """Call the module once, which also lets lazy layers find their sizes."""
        self._result({}, torch.zeros(2, *self._shape, device=device))


@lru_cache(maxsize=256)
def flat_size(options: NetworkConfig, shape: Shape, outputs: int) -> int:
    """Return P, the length of a network's row, without memory for its numbers where its module can do without.

    A module cannot where its constructor reads numbers of tensors, or where it has lazy layers and its call does.

    Raises:
        PluginError: see `FlatModule`.
    """
    try:
        return FlatModule(options, shape, outputs, "meta").size
    except PluginError:
        return FlatModule(options, shape, outputs).size


@torch.no_grad()
def outputs_of(options: NetworkConfig, shape: Shape, outputs: int, flat: Float32, rows: Float32) -> Float32:
    """Return the outputs [E, n, outputs] of some agents' networks.

    Args:
        options: the network's options.
        shape: of one input.
        outputs: numbers that a network returns.
        flat: [n, P], or [1, P] for a network that all share.
        rows: [E, n, o] observations.
    """
    module, parameters = _kept(options, shape, outputs), torch.from_numpy(flat)
    x = torch.from_numpy(np.array(rows))  # a copy, as torch warns about memory that cannot be written
    if len(flat) == 1:
        found = module(parameters[0], x.flatten(0, 1)).view(*x.shape[:2], outputs)
    else:
        own = zip(parameters, x.unbind(1), strict=True)
        found = torch.stack([module(row, seen) for row, seen in own], dim=1)
    return cast(Float32, found.numpy())


def _kept(options: NetworkConfig, shape: Shape, outputs: int) -> FlatModule:
    """Return this thread's module: calls change it for a moment, so threads cannot share one."""
    kept: dict[tuple[NetworkConfig, Shape, int], FlatModule] = vars(_OF_THREAD).setdefault("kept", {})
    key = options, shape, outputs
    if key not in kept:
        while len(kept) >= KEPT:
            kept.pop(next(iter(kept)))
        kept[key] = FlatModule(*key)
    return kept[key]


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Let torch, numpy and random draw from a seed in the body, and then go on as if there had been no body."""
    with _DRAWING, torch.random.fork_rng(devices=[]):
        python, numpy = random.getstate(), np.random.get_state()
        torch.manual_seed(seed)
        random.seed(seed)
        np.random.seed(seed % 2**32)
        try:
            yield
        finally:
            random.setstate(python)
            np.random.set_state(numpy)


def _made(options: NetworkConfig, shape: Shape, outputs: int, device: str) -> tuple[str, nn.Module]:
    """Return what a module is, for errors, and the module."""
    plugin, network = plugins.network(options.name)
    found = plugins.resolve(network.module, f"plug-in {plugin}: network {options.name}")
    what = f"plug-in {plugin}: {network.module.replace(':', '.')}"
    if not callable(found):
        raise PluginError(f"{what} is a {type(found).__name__}, and must be a class derived from torch.nn.Module.")
    with torch.device(device):
        module: nn.Module = plugins.guarded(found, what, (nn.Module,))(shape, outputs, options)
    return what, module.eval()


def _require_trainable(what: str, module: nn.Module, parameters: dict[str, nn.Parameter]) -> None:
    """Raise PluginError unless all that a module learns are parameters of 32-bit floats."""
    if not parameters:
        raise PluginError(f"{what} has no parameters.")
    for name, parameter in parameters.items():
        if parameter.dtype != torch.float32 or not parameter.requires_grad:
            kind = "is frozen" if not parameter.requires_grad else f"is {parameter.dtype}"
            raise PluginError(
                f"{what}: the parameter {name} {kind}; all parameters are trained and 32-bit floats. Register what "
                "never changes as a buffer with persistent=False."
            )
    for name, part in module.named_modules():
        held = [each for each, buffer in part._buffers.items() if buffer is not None]
        if kept := [each for each in held if each not in part._non_persistent_buffers_set]:
            where = f"{name}.{kept[0]}" if name else kept[0]
            raise PluginError(
                f"{what}: the buffer {where} would not reach the workers, as only parameters travel. Take GroupNorm or "
                "LayerNorm for BatchNorm, or register what never changes with persistent=False."
            )


def _brief(error: Exception) -> str:
    """Return the first line of an error's message."""
    return (str(error).strip().splitlines() or [""])[0][:300]
