"""Networks of plug-ins that would act differently in another process, or beside other inputs, are refused."""

import random
import sys
from types import ModuleType

import numpy as np
import pytest
import torch
from torch import nn

from eia_sec.common import plugins
from eia_sec.common.config import NetworkConfig
from eia_sec.common.config.algorithms.network import NETWORK_CONFIGS
from eia_sec.common.errors import PluginError
from eia_sec.common.module_trials import try_network
from eia_sec.common.modules import FlatModule, flat_size

pytestmark = pytest.mark.usefixtures("nothing_stays_loaded")

FIXED = torch.Generator().manual_seed(3)


class Features(nn.Module):
    """A layer behind what `extra` has added to the input."""

    def __init__(self, shape, outputs, options):
        super().__init__()
        self.layer = nn.Linear(*shape, outputs)
        self.drawn(shape)

    def drawn(self, shape):
        """Draw whatever is no parameter."""

    def extra(self, x):
        """Return what the layer reads."""
        return x

    def forward(self, x):
        return self.layer(self.extra(x))


def net(**members):
    """Return a class of such modules with methods of its own."""
    return type("Net", (Features,), members)


@pytest.fixture
def offered(monkeypatch):
    """A function that loads a plug-in with a network, and returns the network's options."""

    def offer(found):
        module = ModuleType("mine")
        module.Net = found
        module.plugin = plugins.Plugin(
            networks={"net": plugins.PluginNetwork("mine:Net", NetworkConfig, reads=("vector", "image"))}
        )
        monkeypatch.setitem(sys.modules, "mine", module)
        plugins.load("mine")
        return NETWORK_CONFIGS["net"]()

    return offer


def buffer(draw):
    """Return a constructor's part that registers a buffer as `draw` draws it."""
    return lambda self, shape: self.register_buffer("B", draw(shape), persistent=False)


def _attribute(self, shape):
    self.noise = torch.randn(shape)


def _counting(self, x):
    self.calls = getattr(self, "calls", 0) + 1
    return x * self.calls


ADDED = {"extra": lambda self, x: x + self.B}


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (net(drawn=buffer(torch.randn), **ADDED), "the buffer B is another one each time it is made"),
        (net(drawn=buffer(lambda shape: torch.from_numpy(np.random.rand(*shape)).float()), **ADDED), "the buffer B is"),
        (net(drawn=buffer(lambda shape: torch.full(shape, random.random())), **ADDED), "the buffer B is another one"),
        (net(drawn=_attribute, extra=lambda self, x: x + self.noise), "something else for the same input and param"),
        (net(extra=lambda self, x: x + torch.rand_like(x)), "something else for the same input and parameters"),
        (net(extra=lambda self, x: x - x.mean(0)), "something else for an input when others are beside it"),
        (net(extra=_counting), "returns something else"),
    ],
)
def test_what_would_act_differently_elsewhere_is_refused(offered, found, said):
    """Whatever draws at random besides parameters, keeps something between calls, or mixes inputs."""
    options = offered(found)
    with pytest.raises(PluginError, match=rf"plug-in mine: mine\.Net.*{said}"):
        try_network(options, (5,), 4)


@pytest.mark.parametrize(
    "found",
    [
        Features,
        net(drawn=buffer(lambda shape: torch.randn(shape, generator=FIXED.manual_seed(3))), **ADDED),
        net(
            drawn=lambda self, shape: setattr(self, "table", nn.Embedding(2, 5)),
            extra=lambda self, x: x + self.table(x[:, 0].long()),
        ),
        net(drawn=lambda self, shape: setattr(self, "layer", nn.utils.weight_norm(self.layer))),
        net(extra=lambda self, x: setattr(self, "seen", x) or x),
    ],
)
def test_what_acts_alike_everywhere_is_taken(offered, found):
    """A fixed seed, an index among the inputs, a weight computed from parameters, an activation that is kept."""
    options = offered(found)
    try_network(options, (5,), 4)
    assert flat_size(options, (5,), 4) == len(FlatModule(options, (5,), 4).drawn(1))


def test_an_image_is_tried_as_bytes(offered):
    """The module reads numbers from 0 to 1 with their channels first."""

    class Seer(nn.Module):
        def __init__(self, shape, outputs, options):
            super().__init__()
            self.layers = nn.Sequential(nn.Conv2d(shape[0], 2, 3), nn.Flatten(), nn.LazyLinear(outputs))

        def forward(self, x):
            assert (x >= 0.0).all()
            assert (x <= 1.0).all()
            return self.layers(x)

    try_network(offered(Seer), (3, 4, 5), 4)


def test_what_is_drawn_besides_parameters_is_the_same_in_all_processes(offered):
    """It comes from a fixed seed whatever was drawn before, and nobody else's numbers change."""
    options = offered(net(drawn=buffer(torch.randn), **ADDED))
    torch.manual_seed(1)
    np.random.seed(1)
    random.seed(1)
    one = FlatModule(options, (5,), 4)
    after = torch.rand(1), np.random.rand(), random.random()
    other = FlatModule(options, (5,), 4)
    assert torch.equal(one.buffers()["B"], other.buffers()["B"])
    torch.manual_seed(1)
    np.random.seed(1)
    random.seed(1)
    assert (torch.rand(1), np.random.rand(), random.random()) == after
    np.testing.assert_array_equal(one.drawn(7), other.drawn(7))
    assert not np.array_equal(one.drawn(7), one.drawn(8))
