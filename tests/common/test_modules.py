"""Networks of plug-ins: what they are given, how they are refused, and the files that hold their actors."""

import json
import subprocess
import sys
from dataclasses import dataclass, field, replace
from types import ModuleType

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.numpy import load_file, save_file
from torch import nn

from eia_sec.common import plugins
from eia_sec.common.actors import TeamActors, actor_outputs
from eia_sec.common.config import NetworkConfig
from eia_sec.common.config.algorithms.network import NETWORK_CONFIGS
from eia_sec.common.errors import PluginError, PolicyError, SchemaError
from eia_sec.common.module_trials import try_network
from eia_sec.common.modules import FlatModule, flat_size, outputs_of
from eia_sec.common.policy_file import load_policy, save_policy
from eia_sec.common.policy_store import PolicyStore
from eia_sec.common.protocol.messages import ParametersMessage
from eia_sec.common.team import GroupSpec, TeamSpec

pytestmark = pytest.mark.usefixtures("nothing_stays_loaded")

PICTURES = TeamSpec((GroupSpec("seer", 2, 4 * 5 * 3 + 3, 1, choices=(3,), masked=True, image=(4, 5, 3)),))
"""Agents that see an image of four by five places with three channels, and a mask behind it."""
VECTORS = TeamSpec((GroupSpec("walker", 3, 5, 2),))


@dataclass(frozen=True)
class Lists(NetworkConfig):
    """Options whose value is a list."""

    widths: list[int] = field(default_factory=lambda: [1])
    """Units."""


@dataclass(frozen=True)
class Table(NetworkConfig):
    """Options of a type that no configuration has."""

    widths: complex = 1j
    """Units."""


@dataclass(frozen=True)
class Width(NetworkConfig):
    """Options of a network."""

    width: int = 4
    """Units."""


class Wide(nn.Module):
    """A layer of units; remembers what it was given."""

    seen = None

    def __init__(self, shape, outputs, options):
        super().__init__()
        self.layers = nn.Sequential(nn.Flatten(), nn.LazyLinear(options.width), nn.ReLU(), nn.LazyLinear(outputs))

    def forward(self, x):
        if not x.is_meta:
            Wide.seen = x
        return self.layers(x)


def offered(monkeypatch, found=Wide, reads="vector", options=Width):
    """Load a plug-in with a network, and return the network's options."""
    module = ModuleType("mine")
    module.Net = found
    module.plugin = plugins.Plugin(networks={"net": plugins.PluginNetwork("mine:Net", options, reads)})
    monkeypatch.setitem(sys.modules, "mine", module)
    plugins.load("mine")
    return NETWORK_CONFIGS["net"]()


def actors_of(team, options, shared=True):
    """Return actors with drawn parameters."""
    flat = []
    for group in team.groups:
        drawn = FlatModule(options, group.seen, actor_outputs(group, "gaussian")).drawn
        flat.append(np.stack([drawn(index) for index in range(1 if shared else group.count)]))
    return TeamActors(team, 1, tuple(flat), "gaussian", module=options)


def test_images_arrive_as_numbers_from_0_to_1_with_their_channels_first(monkeypatch):
    """Rows hold them by row, column and channel, with the mask behind; the module sees the image alone."""
    options = offered(monkeypatch, reads="image")
    actors = actors_of(PICTURES, options)
    image = np.random.default_rng(0).integers(0, 256, (7, 2, 4, 5, 3), np.uint8)
    mask = np.ones((7, 2, 3), np.uint8)
    rows = np.concatenate([image.reshape(7, 2, -1), mask], axis=2).reshape(7, -1)
    ((_, seen, outputs),) = actors.outputs(rows)
    assert seen.dtype == np.uint8
    assert outputs.shape == (7, 2, 3)
    expected = torch.from_numpy(image.reshape(14, 4, 5, 3)).permute(0, 3, 1, 2).float() / 255
    torch.testing.assert_close(Wide.seen, expected)
    for kind in (np.float32, np.uint8):
        np.testing.assert_array_equal(actors.act(rows.astype(kind)), actors.act(rows))


def test_agents_of_their_own_have_rows_of_their_own(monkeypatch):
    """Each acts by its row; the shared row is everybody's; equal seeds draw equal rows."""
    options = offered(monkeypatch)
    own, shared = actors_of(VECTORS, options, shared=False), actors_of(VECTORS, options)
    np.testing.assert_array_equal(own.flat[0][0], shared.flat[0][0])
    x = np.random.default_rng(1).standard_normal((4, 3, 5)).astype(np.float32)
    (_, _, outputs), (_, _, all_alike) = next(own.outputs(x.reshape(4, -1))), next(shared.outputs(x.reshape(4, -1)))
    np.testing.assert_allclose(outputs[:, 0], all_alike[:, 0], rtol=1e-5)
    assert not np.allclose(outputs[:, 1], all_alike[:, 1])
    for index in range(3):
        alone = outputs_of(options, (5,), 4, own.flat[0][index : index + 1], x[:, index : index + 1])
        np.testing.assert_allclose(outputs[:, index], alone[:, 0], rtol=1e-5)


def test_a_row_begins_with_what_inputs_are_scaled_by(monkeypatch):
    """Shift and scale come before the parameters, and are those of the vector that the module reads."""
    options = offered(monkeypatch)
    actors = actors_of(VECTORS, options)
    row = actors.flat[0][0]
    assert (row[:5] == 0).all()
    assert (row[5:10] == 1).all()
    assert len(row) == 10 + (5 * 4 + 4) + (4 * 4 + 4) == flat_size(options, (5,), 4)
    row[:5], row[5:10] = 2.0, 3.0
    actors.act(np.full((1, 15), 0.5, np.float32))
    assert torch.equal(Wide.seen, torch.full((3, 5), 3.5))


def test_a_size_takes_no_memory(monkeypatch):
    """A network of a hundred thousand units a layer would take 40 GB; its size is known without."""
    options = replace(offered(monkeypatch), width=100_000)

    class Huge(nn.Module):
        def __init__(self, shape, outputs, options):
            super().__init__()
            self.layers = nn.Sequential(
                nn.Linear(*shape, options.width), nn.Linear(options.width, 10**5), nn.Linear(10**5, outputs)
            )

        def forward(self, x):
            return self.layers(x)

    sys.modules["mine"].Net = Huge
    assert flat_size(options, (5,), 4) > 10**10


def test_a_size_needs_no_call(monkeypatch):
    """A call that reads numbers of its input works in memory alone, which forged options could ask too much of."""
    options = replace(offered(monkeypatch), width=10**9)

    class Careful(nn.Module):
        def __init__(self, shape, outputs, options):
            super().__init__()
            self.layers = nn.Sequential(nn.Linear(*shape, options.width), nn.Linear(options.width, outputs))

        def forward(self, x):
            if not torch.isfinite(x).all():
                raise ValueError
            return self.layers(x)

    sys.modules["mine"].Net = Careful
    assert flat_size(options, (5,), 4) == 10 + 10**9 * 10 + 4


def test_a_buffer_that_is_none_holds_nothing(monkeypatch):
    """Instance normalisation has two such buffers."""

    class Normalising(nn.Module):
        def __init__(self, shape, outputs, options):
            super().__init__()
            self.layers = nn.Sequential(nn.InstanceNorm2d(shape[0]), nn.Flatten(), nn.LazyLinear(outputs))

        def forward(self, x):
            return self.layers(x)

    options = offered(monkeypatch, Normalising, "image")
    try_network(options, (3, 4, 5), 4)
    assert flat_size(options, (3, 4, 5), 4) == 3 * 4 * 5 * 4 + 4


def test_an_image_of_numbers_stays_as_it_is(monkeypatch):
    """Rows of a team where others see vectors are numbers; scaling pixels does not change them."""
    network = FlatModule(offered(monkeypatch, reads="image"), (1, 4, 5), 2)
    rows = torch.full((3, 20), 51.0)
    assert torch.equal(network.inputs([], rows), torch.full((3, 1, 4, 5), 0.2))
    assert torch.equal(rows, torch.full((3, 20), 51.0))


def made(forward=None, *, layer=None, **members):
    """Return a class of a module with a layer."""

    class Net(nn.Module):
        def __init__(self, shape, outputs, options):
            super().__init__()
            self.layer = nn.Linear(5, outputs) if layer is None else layer(outputs)

    Net.forward = forward or (lambda self, x: self.layer(x))
    for name, member in members.items():
        setattr(Net, name, member)
    return Net


def _half(outputs):
    return nn.Linear(5, outputs).double()


def _frozen(outputs):
    return nn.Linear(5, outputs).requires_grad_(requires_grad=False)


def _raises(shape, outputs, options):
    raise ValueError("no such thing")


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (3, r"mine\.Net is a int, and must be a class derived from torch\.nn\.Module"),
        (lambda shape, outputs, options: 3, r"mine\.Net returned a int, and must return a Module"),
        (_raises, r"mine\.Net raised ValueError: no such thing"),
        (made(lambda self, x: self.layer(x)[0]), r"forward returned \[4\] for \[2, 5\], and must return a tensor \[2"),
        (made(lambda self, x: 0.0), r"forward returned a float for \[2, 5\]"),
        (made(lambda self, x: self.layer(x[:, :3])), r"forward raised RuntimeError"),
        (made(lambda self, x: x[:, :4], layer=lambda outputs: None), r"mine\.Net has no parameters"),
        (made(layer=lambda outputs: nn.Sequential(nn.Linear(5, outputs), nn.BatchNorm1d(outputs))), "buffer layer.1"),
        (made(lambda self, x: self.layer(x.double()), layer=_half), r"parameter layer\.weight is torch\.float64"),
        (made(layer=_frozen), r"parameter layer\.weight is frozen"),
    ],
)
def test_a_network_that_cannot_be_used_is_named(monkeypatch, found, said):
    """The sentence names plug-in, class and method, what came and what was expected."""
    options = offered(monkeypatch, found)
    with pytest.raises(PluginError, match=f"plug-in mine: .*{said}"):
        try_network(options, (5,), 4)


@pytest.mark.parametrize(
    ("network", "said"),
    [
        ("mine:Net", "network net is a str, and must be an eia_sec.PluginNetwork"),
        (plugins.PluginNetwork("mine"), "its module is named as module:name, not 'mine'"),
        (plugins.PluginNetwork("mine:Net", reads="sound"), "reads 'sound', and must read vector or image, or both"),
        (plugins.PluginNetwork("mine:Net", reads=()), "reads .., and must read"),
        (plugins.PluginNetwork("mine:Net", int), "its options are a type, and must be a dataclass derived from Netw"),
        (plugins.PluginNetwork("mine:Net", Lists), "its options Lists cannot be used: unhashable type: 'list'"),
        (plugins.PluginNetwork("mine:Net", Table), "the option widths of Table is a <class 'complex'>, and must be a"),
    ],
)
def test_a_network_that_cannot_be_offered_is_named(monkeypatch, network, said):
    """Before anything of it is imported."""
    module = ModuleType("mine")
    module.plugin = plugins.Plugin(networks={"net": network})
    monkeypatch.setitem(sys.modules, "mine", module)
    with pytest.raises(PluginError, match=f"plug-in mine: .*{said}"):
        plugins.load("mine")
    assert "net" not in NETWORK_CONFIGS


def test_no_network_takes_the_name_of_the_perceptrons(monkeypatch):
    """Else it could not be chosen."""
    module = ModuleType("mine")
    module.plugin = plugins.Plugin(networks={"mlp": plugins.PluginNetwork("mine:Net")})
    monkeypatch.setitem(sys.modules, "mine", module)
    with pytest.raises(PluginError, match="the name mlp is taken"):
        plugins.load("mine")


def test_a_policy_file_names_its_network(monkeypatch, tmp_path):
    """It holds the actors and the network's options, and is refused without the plug-in."""
    actors = actors_of(PICTURES, replace(offered(monkeypatch, reads="image"), width=6), shared=False)
    path = tmp_path / "policy.safetensors"
    save_policy(path, actors, {"seed": "1"})
    found, metadata = load_policy(path)
    assert (found.digest(), found.module, found.team) == (actors.digest(), actors.module, PICTURES)
    assert metadata == {"seed": "1"}
    NETWORK_CONFIGS.pop("net")
    with pytest.raises(PluginError, match="uses the network net of the plug-in mine; add --plugin mine to run"):
        load_policy(path)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"name": "net", "width": 5}, r"its seer actors are F32\[1, \d+\], not floats"),
        ({"name": "net", "width": "6"}, "width must be a whole number"),
        ({"name": "net", "depth": 6}, "unknown configuration key depth"),
        ({"name": "net", "width": 10**9}, r"its seer actors are F32\[1, \d+\], not floats"),
    ],
)
def test_forged_options_of_a_network_are_refused(monkeypatch, tmp_path, options, said):
    """Options that do not exist, have another type, or do not fit the parameters in the file; none takes memory."""
    actors = actors_of(PICTURES, replace(offered(monkeypatch, reads="image"), width=6))
    path = tmp_path / "policy.safetensors"
    save_policy(path, actors, {})
    tensors = load_file(path)
    with safe_open(path, "numpy") as file:
        metadata = file.metadata()
    save_file(tensors, path, {**metadata, "network": json.dumps({"plugin": "mine", "options": options})})
    with pytest.raises(PolicyError, match=said):
        load_policy(path)


def test_parameters_are_checked_by_the_shapes_of_the_runs_network(monkeypatch):
    """A worker takes those of the network that its configuration names, and no others."""
    options = offered(monkeypatch)
    actors = actors_of(VECTORS, options)

    def message(flat):
        return ParametersMessage(1, 1, 0, 0, 0.0, VECTORS.digest, 1, "gaussian", flat)

    store = PolicyStore(VECTORS, options)
    assert store.offer_parameters(message(actors.flat))
    assert store.actors.digest() == actors.digest()
    for wrong in (actors.flat[0][:, 1:], actors.flat[0] * np.nan):
        with pytest.raises(SchemaError, match="walker actors"):
            PolicyStore(VECTORS, options).offer_parameters(message((np.ascontiguousarray(wrong),)))
    with pytest.raises(SchemaError, match="walker actors"):
        PolicyStore(VECTORS).offer_parameters(message(actors.flat))


def test_perceptrons_load_no_torch():
    """Who acts with perceptrons does without it, though the plug-in with a network is loaded."""
    code = (
        "import sys, numpy as np, eia_sec.common.plugins as p; p.load('pictures')\n"
        "from eia_sec.common.actors import TeamActors\n"
        "from eia_sec.common.team import GroupSpec, TeamSpec\n"
        "team = TeamSpec((GroupSpec('a', 2, 3, 2),))\n"
        "TeamActors.initial(team, 4, 0).act(np.zeros((1, 6), np.float32))\n"
        "print('torch' in sys.modules)"
    )
    own = {"PYTHONPATH": ":".join(part for part in sys.path if part)}
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=own, check=True)
    assert found.stdout == "False\n"
