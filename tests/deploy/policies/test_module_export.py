"""Exported networks of a plug-in act as the policy does."""

import json
import sys
import warnings
from types import ModuleType

import numpy as np
import onnxruntime
import pytest
import torch
from safetensors.numpy import load_file
from torch import nn

from eia_sec.common import plugins
from eia_sec.common.actors import TeamActors, actor_outputs
from eia_sec.common.config import EnvConfig, NetworkConfig, RunConfig
from eia_sec.common.config.algorithms.network import NETWORK_CONFIGS
from eia_sec.common.errors import PolicyError
from eia_sec.common.modules import FlatModule
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.deploy.policies.export import agent_names, export_onnx, export_safetensors

pytestmark = pytest.mark.usefixtures("nothing_stays_loaded")

IMAGE = GroupSpec("seer", 2, 5 * 4 * 3 + 5, 2, choices=(3, 2), masked=True, image=(5, 4, 3))
VECTOR = GroupSpec("walker", 3, 6, 2)
CONFIG = RunConfig(env=EnvConfig("some.module:env"))


class Both(nn.Module):
    """Reads images and vectors."""

    def __init__(self, shape, outputs, options):
        super().__init__()
        first = nn.Conv2d(shape[0], 4, 3) if len(shape) == 3 else nn.Linear(*shape, 24)
        self.layers = nn.Sequential(first, nn.GELU(), nn.Flatten(), nn.LayerNorm(24), nn.Linear(24, outputs))

    def forward(self, x):
        return self.layers(x)


class Strange(Both):
    """Does what ONNX cannot say."""

    def forward(self, x):
        return torch.linalg.eigvals(x.T @ x).real.sum() + super().forward(x)


class Counted(Both):
    """Takes the number of inputs as one of Python's."""

    def forward(self, x):
        return super().forward(x.reshape(len(x), -1))


class Branching(Both):
    """Does one of two things, by what it sees."""

    def forward(self, x):
        return super().forward(-x if x.sum() > 0 else x)


class Fixed(Both):
    """Has the number of inputs in its graph, though nothing says so when it is traced."""

    def forward(self, x):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return super().forward(x.reshape(len(x), -1))


class Attending(Both):
    """Has layers of torch that compare shapes."""

    def __init__(self, shape, outputs, options):
        super().__init__(shape, outputs, options)
        self.attention = nn.MultiheadAttention(2, 1, batch_first=True)

    def forward(self, x):
        tokens = x.view(x.shape[0], -1, 2)
        return super().forward((tokens + self.attention(tokens, tokens, tokens)[0]).flatten(1))


class Scaling(Both):
    """Has parameters of names that its input might have."""

    def __init__(self, shape, outputs, options):
        super().__init__(shape, outputs, options)
        self.scale = nn.Parameter(torch.full((outputs,), 3.0))

    def forward(self, x):
        return super().forward(x) * self.scale


def actors_of(monkeypatch, found, *groups):
    """Return actors of a plug-in's network, with scales of inputs that are not 1."""
    module = ModuleType("mine")
    module.Net = found
    offer = plugins.PluginNetwork("mine:Net", NetworkConfig, reads=("image", "vector"))
    module.plugin = plugins.Plugin(networks={"net": offer})
    monkeypatch.setitem(sys.modules, "mine", module)
    plugins.load("mine")
    options, flat = NETWORK_CONFIGS["net"](), []
    for group in groups:
        network = FlatModule(options, group.seen, actor_outputs(group, "gaussian"))
        rows = np.stack([network.drawn(index) for index in range(group.count)])
        if not group.image:
            size = group.observation_size
            rows[:, :size], rows[:, size : 2 * size] = 0.5, np.linspace(0.5, 2.0, size)
        flat.append(rows)
    return TeamActors(TeamSpec(groups), 1, tuple(flat), "gaussian", module=options)


def test_models_act_as_the_policy_does(monkeypatch, tmp_path):
    """Choices with masks from images, and continuous actions from vectors whose scales differ from 1."""
    actors, draw = actors_of(monkeypatch, Both, IMAGE, VECTOR), np.random.default_rng(1)
    rows = draw.standard_normal((20, actors.team.observation_size)).astype(np.float32)
    images = rows[:, : 2 * IMAGE.observation_size].reshape(20, 2, -1)
    images[..., :-5] = draw.integers(0, 256, images[..., :-5].shape)
    images[..., -5:] = draw.random(images[..., -5:].shape) < 0.7
    wanted = actors.team.split_actions(actors.act(rows))
    seen = actors.team.split_observations(rows)
    paths = export_onnx(tmp_path, CONFIG, actors, {"seed": "1"})
    assert [path.name for path in paths] == [*(f"{name}.onnx" for name in agent_names(actors)), "actors.json"]
    each = [
        (part[:, index], own[:, index])
        for part, own in zip(seen, wanted, strict=True)
        for index in range(part.shape[1])
    ]
    for path, (observation, action) in zip(paths[:-1], each, strict=True):
        session = onnxruntime.InferenceSession(path)
        (found,) = session.run(["action"], {"observation": np.ascontiguousarray(observation)})
        np.testing.assert_allclose(found, action, atol=1e-5)
        assert json.loads(session.get_modelmeta().custom_metadata_map["module"])["plugin"] == "mine"
    described = json.loads((tmp_path / "actors.json").read_text())
    assert described["agents"]["seer-0"]["image"] == [5, 4, 3]
    assert described["format"] == "eia-sec plug-in actors 1"


def test_tensors_have_the_names_of_the_module(monkeypatch, tmp_path):
    """They fill a module of the plug-in's class, which then computes the same."""
    actors = actors_of(monkeypatch, Both, VECTOR)
    export_safetensors(tmp_path, CONFIG, actors, {})
    tensors = {name: torch.from_numpy(array) for name, array in load_file(tmp_path / "actors.safetensors").items()}
    own = {name.removeprefix("walker-1."): each for name, each in tensors.items() if name.startswith("walker-1.")}
    network = Both((6,), 4, None)
    scale, shift = own.pop("input.scale"), own.pop("input.shift")
    network.load_state_dict(own)
    row = torch.randn(1, 3, 6)
    ((_, _, outputs),) = actors.outputs(row.flatten(1).numpy())
    torch.testing.assert_close(network(row[:, 1] * scale + shift), torch.from_numpy(outputs[:, 1]))


def test_what_onnx_cannot_say_is_refused(monkeypatch, tmp_path):
    """The sentence names network and plug-in, and what works."""
    actors = actors_of(monkeypatch, Strange, VECTOR)
    with pytest.raises(
        PolicyError, match=r"torch cannot write the network net of the plug-in mine as ONNX \(.*\); --f"
    ):
        export_onnx(tmp_path, CONFIG, actors, {})


@pytest.mark.parametrize(
    ("found", "said"),
    [
        (Counted, r"test_module_export\.py, line \d+ takes numbers or a length out of tensors"),
        (Branching, r"test_module_export\.py, line \d+ takes numbers or a length out of tensors"),
        (Fixed, "its graph takes no batch of 1"),
    ],
)
def test_graphs_that_would_do_something_else_are_refused(monkeypatch, tmp_path, found, said):
    """A vehicle acts on one observation, and a graph is made from two."""
    actors = actors_of(monkeypatch, found, VECTOR)
    with pytest.raises(PolicyError, match=rf"cannot write the network net of the plug-in mine as ONNX \(.*{said}"):
        export_onnx(tmp_path, CONFIG, actors, {})


def test_layers_of_torch_that_compare_shapes_are_exported(monkeypatch, tmp_path):
    """Shapes of one input do not change."""
    actors = actors_of(monkeypatch, Attending, VECTOR)
    path = export_onnx(tmp_path, CONFIG, actors, {})[0]
    row = np.random.default_rng(1).standard_normal((1, actors.team.observation_size)).astype(np.float32)
    (found,) = onnxruntime.InferenceSession(path).run(["action"], {"observation": row[:, :6].copy()})
    np.testing.assert_allclose(found[0], actors.act(row)[0, :2], atol=1e-5)


def test_a_modules_own_scale_is_not_that_of_its_input(monkeypatch, tmp_path):
    """Both are in the file."""
    export_safetensors(tmp_path, CONFIG, actors_of(monkeypatch, Scaling, VECTOR), {})
    tensors = load_file(tmp_path / "actors.safetensors")
    np.testing.assert_array_equal(tensors["walker-0.scale"], np.full(4, 3.0, np.float32))
    np.testing.assert_array_equal(tensors["walker-0.input.scale"], np.linspace(0.5, 2.0, 6, dtype=np.float32))
