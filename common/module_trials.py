"""Trials of a plug-in's networks before a run begins: each is made and called as learner and workers will.

Workers, the learner, a resumed run and an exported policy each make a network's module anew, fill it with the same
parameters, and call it with as many inputs as they have. All must get the same outputs for the same input.
"""

import math
from functools import lru_cache
from typing import Final

import torch
from torch import Tensor

from eia_sec.common.config import NetworkConfig
from eia_sec.common.errors import PluginError
from eia_sec.common.modules import WHITE, FlatModule, seeded
from eia_sec.common.team import Shape

ROWS: Final = 8
"""Inputs of a trial."""
NOISE: Final = 0.3
"""By how much a trial's parameters differ from fresh ones, which may be zero, in deviations of them."""
TOLERANCE: Final = 1e-4
"""Share of the largest output by which outputs may differ, as sums in another order do."""


@lru_cache(maxsize=256)
@torch.no_grad()
def try_network(options: NetworkConfig, shape: Shape, outputs: int) -> None:
    """Make a network's module twice, and call it with several inputs and with one.

    Args:
        options: the network's options.
        shape: of one input.
        outputs: numbers that it returns.

    Raises:
        PluginError: it cannot be made or used; or it holds something else, or returns something else for an input,
            each time it is made or called, or with other inputs beside it.
    """
    network, again = (FlatModule(options, shape, outputs, seed=seed) for seed in range(2))
    _require_equal_buffers(network, again)
    flat = _moved(network)
    rows, found = called(network, flat, shape)
    with seeded(3):
        once_more = again(flat, rows)
    if not alike(found, once_more):
        raise PluginError(
            f"{network.what} returns something else for the same input and parameters when it is made or called anew, "
            "as happens in every worker. Draw what never changes with a torch.Generator of a fixed seed, and keep "
            "nothing from one call to the next."
        )
    if not alike(found[:1], network(flat, rows[:1])):
        raise PluginError(
            f"{network.what} returns something else for an input when others are beside it; workers and the learner "
            "call it with different numbers of inputs, so each output must depend on its own input alone."
        )


def _require_equal_buffers(network: FlatModule, again: FlatModule) -> None:
    others = again.buffers()
    for name, buffer in network.buffers().items():
        other = others.get(name)
        if other is None or other.shape != buffer.shape or not torch.equal(buffer, other):
            raise PluginError(
                f"{network.what}: the buffer {name} is another one each time it is made, as happens in every worker; "
                "draw it with a torch.Generator of a fixed seed, or make it a parameter."
            )


def _moved(network: FlatModule) -> Tensor:
    """Return parameters [P] near fresh ones."""
    flat, draw = torch.from_numpy(network.drawn(0)), torch.Generator().manual_seed(1)
    for parameter in network.named(flat).values():
        size = float(parameter.square().mean().sqrt()) or 1.0
        parameter.add_(torch.randn(parameter.shape, generator=draw), alpha=NOISE * size)
    return flat


@torch.no_grad()
def called(network: FlatModule, flat: Tensor, shape: Shape) -> tuple[Tensor, Tensor]:
    """Return inputs [ROWS, o] and a network's outputs [ROWS, outputs] for them.

    Inputs are any numbers, or zeros and ones, or zeros: the first that the network takes. What observations may be is
    not known here, and a module may use a number as an index.

    Args:
        network: the network.
        flat: [P] its parameters.
        shape: of one input.

    Raises:
        PluginError: it takes no zeros.
    """
    draw, size = torch.Generator().manual_seed(2), math.prod(shape)
    image = len(shape) > 1
    bits = torch.randint(2, (ROWS, size), generator=draw)
    pixels = torch.randint(int(WHITE) + 1, (ROWS, size), generator=draw)
    numbers = torch.randn((ROWS, size), generator=draw)
    for rows in (pixels if image else numbers, bits):
        try:
            with seeded(2):
                return rows, network(flat, rows)
        except PluginError:
            continue
    return torch.zeros(ROWS, size), network(flat, torch.zeros(ROWS, size))


def alike(one: Tensor, other: Tensor) -> bool:
    """Return whether outputs are equal but for rounding."""
    largest = one.nan_to_num(0.0, 0.0, 0.0).abs().amax()
    return torch.allclose(one, other, rtol=TOLERANCE, atol=TOLERANCE * float(largest), equal_nan=True)
