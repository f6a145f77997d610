"""Choices and adapters as ONNX nodes: the very numbers of the actors' own code."""

from dataclasses import replace

import numpy as np
import onnxruntime
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from onnx import TensorProto, helper, numpy_helper

from eia_sec.common.actions.adapters import SIGNS, Headings, Lattice, MirroredAxes, NineMoves
from eia_sec.common.actors import TeamActors
from eia_sec.common.config import EnvConfig, RunConfig
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.deploy.policies.export import IR_VERSION, OPSET, export_onnx
from eia_sec.deploy.policies.onnx_actions import LAST, action_nodes

HEADINGS = Headings(0.041, 0.12, 0.35, 0.9, 0.025)
LATTICE = Lattice(40, 37, 0.025, 0.0271)
INSET = replace(LATTICE, inset=0.36)
GROUPS = {
    "moves": GroupSpec("a", 1, 6, 1, (NineMoves(), LATTICE), (9,)),
    "mirrored moves": GroupSpec("a", 1, 6, 1, (NineMoves(), LATTICE, MirroredAxes()), (9,)),
    "inset moves": GroupSpec("a", 1, 6, 1, (NineMoves(), INSET), (9,)),
    "mirrored inset moves": GroupSpec("a", 1, 6, 1, (NineMoves(), INSET, MirroredAxes()), (9,)),
    "headings": GroupSpec("a", 1, 6, 1, (HEADINGS,), (25,)),
    "mirrored headings": GroupSpec("a", 1, 6, 1, (HEADINGS, MirroredAxes()), (25,)),
    "plain": GroupSpec("a", 1, 6, 1, choices=(5,)),
    "branches": GroupSpec("a", 1, 6, 3, choices=(2, 1, 7)),
    "masked": GroupSpec("a", 1, 14, 2, choices=(4, 3), masked=True),
    "masked moves": GroupSpec("a", 1, 14, 1, (NineMoves(), LATTICE), (9,), masked=True),
}


def from_logits(group):
    """Return a model of the nodes after the last layer, with logits as an input."""
    nodes, numbers = action_nodes(group)
    both = {"observation": group.observation_size, LAST: group.options}
    graph = helper.make_graph(
        [helper.make_node(node.operator, node.inputs, [node.output], **node.attributes) for node in nodes],
        "nodes",
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", size]) for name, size in both.items()],
        [helper.make_tensor_value_info("action", TensorProto.FLOAT, ["batch", group.environment_action_size])],
        [numpy_helper.from_array(array, name) for name, array in numbers.items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], ir_version=IR_VERSION)
    return onnxruntime.InferenceSession(model.SerializeToString())


def from_code(group, observation, logits):
    """Return what the actors do with these logits: their last layer passes on what its bias says."""
    found = []
    for seen, wanted in zip(observation, logits, strict=True):
        actors = TeamActors.initial(TeamSpec((group,)), 1, 0)
        actors.flat[0][:] = 0.0
        actors.flat[0][0, -group.options :] = wanted
        found.append(actors.environment_actions(seen[None])[0])
    return np.stack(found)


MODELS = {name: from_logits(group) for name, group in GROUPS.items()}


@pytest.mark.parametrize("name", GROUPS)
@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32), ties=st.booleans())
def test_the_nodes_give_the_actors_numbers_bit_for_bit(name, seed, ties):
    """Equal logits give equal numbers, ties and masks without a legal option included.

    onnxruntime's Where drops the sign of a zero, so zeros are compared as numbers.
    """
    group, draw = GROUPS[name], np.random.default_rng(seed)
    observation = draw.uniform(-1, 1, (8, group.observation_size)).astype(np.float32)
    observation[0, :2] = 0.0
    observation[:, SIGNS] = draw.choice([-1.0, 1.0], (8, 2))
    if group.masked:
        observation[:, -group.options :] = draw.integers(0, 2, (8, group.options))
        observation[1, -group.options :] = 0.0
    logits = draw.normal(size=(8, group.options)).astype(np.float32)
    logits = np.rint(logits) if ties else logits
    (found,) = MODELS[name].run(["action"], {"observation": observation, LAST: logits})
    assert found.dtype == np.float32
    wanted = from_code(group, observation, logits)
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("shared", [False, True])
@pytest.mark.parametrize("name", GROUPS)
def test_every_agent_has_a_model(name, shared, tmp_path):
    """Agents that share their parameters have a model each, and all of these choose alike."""
    group = replace(GROUPS[name], count=3)
    team = TeamSpec((group,))
    actors = TeamActors.initial(team, 8, 2, per_type=False, shared=shared)
    actors = TeamActors(team, 8, tuple(flat * np.float32(5.0) for flat in actors.flat))
    files = export_onnx(tmp_path, RunConfig(env=EnvConfig("some.module:env")), actors, {})
    assert [file.name for file in files] == ["a-0.onnx", "a-1.onnx", "a-2.onnx", "actors.json"]
    rows = np.random.default_rng(1).uniform(-1, 1, (40, team.observation_size)).astype(np.float32)
    seen = team.split_observations(rows)[0]
    wanted = team.split_environment_actions(actors.environment_actions(rows))[0]
    for index, file in enumerate(files[:3]):
        (found,) = onnxruntime.InferenceSession(file).run(["action"], {"observation": seen[:, index]})
        np.testing.assert_array_equal(found, wanted[:, index])
