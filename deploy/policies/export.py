"""A policy's actors as files that do not need this project: ONNX, or plain tensors with a description."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from safetensors.numpy import save

from eia_sec.common import plugins
from eia_sec.common.actions.descriptions import ADAPTERS
from eia_sec.common.actors import TeamActors, actor_outputs, parameter_views
from eia_sec.common.config import NetworkConfig, RunConfig
from eia_sec.common.config.files import digest
from eia_sec.common.environment import TensorNames
from eia_sec.common.errors import PolicyError
from eia_sec.common.farm import farm_environment, farm_of
from eia_sec.common.gru import Memory
from eia_sec.common.team import Float32, GroupSpec
from eia_sec.deploy.local import contained_files
from eia_sec.deploy.policies.onnx_actions import action_nodes
from eia_sec.deploy.policies.onnx_networks import NEXT_STATE, STATE, Network, network_nodes

if TYPE_CHECKING:
    from onnx import ModelProto

FORMATS: Final[dict[Memory, str]] = {"none": "eia-sec actors 4", "gru": "eia-sec recurrent actors 2"}
"""Format of the description by the actors' memory."""
LAYERS: Final[dict[Memory, tuple[str, ...]]] = {
    "none": ("w1", "b1", "w2", "b2", "w3", "b3"),
    "gru": ("w1", "b1", "w", "b", "u", "c", "w3", "b3"),
}
"""Names of an agent's layers in the files, by its memory."""
NETWORKS: Final[dict[Memory, str]] = {
    "none": "z = relu(relu(o w1 + b1) w2 + b2) w3 + b3",
    "gru": "x = relu(o w1 + b1); p = x w + b, q = h u + c, each of three parts; r = sigmoid(p[0] + q[0]), "
    "y = sigmoid(p[1] + q[1]), n = tanh(p[2] + r q[2]); next h = n + y (h - n); z = (next h) w3 + b3",
}
"""What a network computes, by its memory; h is its state, 0 where an episode begins."""
OPSET: Final = 13
"""Operator set of the models; every onnxruntime since 2020 supports it."""
IR_VERSION: Final = 7
"""ONNX file version for this operator set."""
MODULES: Final = "eia-sec plug-in actors 1"
"""Format of the description of a plug-in's networks."""


def agent_names(actors: TeamActors) -> list[str]:
    """Return a name for each agent in row order: its type and its number inside the type."""
    return [f"{group.name}-{index}" for group in actors.team.groups for index in range(group.count)]


def agent_layers(actors: TeamActors) -> list[dict[str, Float32]]:
    """Return each agent's layers by their names in the files.

    These are LAYERS, with the shapes of `eia_sec.common.actors.layer_shapes`.

    A last layer has as many outputs as the action numbers, or one for each option. Agents that share their parameters
    have equal layers.
    """
    if actors.module is not None:
        return _module_layers(actors, actors.module)
    agents, plain = [], actors.noise_free()
    for group, flat in zip(plain.team.groups, plain.flat, strict=True):
        sizes = group.observation_size, plain.hidden, actor_outputs(group, plain.head)
        named = dict(zip(LAYERS[plain.memory], parameter_views(flat, *sizes, plain.memory), strict=True))
        rows = range(group.count) if len(flat) > 1 else [0] * group.count
        agents += [{name: view[row].copy() for name, view in named.items()} for row in rows]
    return agents


def _module_layers(actors: TeamActors, module: NetworkConfig) -> list[dict[str, Float32]]:
    from eia_sec.deploy.policies.onnx_modules import module_layers  # noqa: PLC0415  (loads torch)

    return [module_layers(module, group, row) for group, row in _rows(actors)]


def _rows(actors: TeamActors) -> list[tuple[GroupSpec, Float32]]:
    """Return each agent's group, and its parameters [P]."""
    pairs = zip(actors.team.groups, actors.flat, strict=True)
    return [(group, flat[index % len(flat)]) for group, flat in pairs for index in range(group.count)]


def kinds_of(actors: TeamActors) -> list[GroupSpec]:
    """Return each agent's group in row order."""
    return [group for group in actors.team.groups for _ in range(group.count)]


def description(config: RunConfig, actors: TeamActors, metadata: Mapping[str, str]) -> dict[str, Any]:
    """Return a description of the actors for their users, as plain values.

    Args:
        config: the run that trained them.
        actors: the actors.
        metadata: their origin, from the policy file.
    """
    kinds = kinds_of(actors)
    return {
        **_network(actors),
        "outputs": {
            "continuous": "a = tanh(z)",
            "choices": "a[k] = argmax of z over branch k's options; masked: where o's last numbers exceed 0.5",
        },
        "adapters": {kind: adapter.formula for kind, adapter in ADAPTERS.items()},
        "origin": {**metadata, "configuration": digest(config), "environment": config.env.name},
        "sha256": actors.digest(),
        "hidden": actors.hidden,
        "agents": {
            name: {
                "type": group.name,
                **asdict(tensor_names(config, group)),
                "choices": list(group.choices),
                "masked": group.masked,
                **({"image": list(group.image)} if group.image else {}),
                "adapters": [{"kind": adapter.kind, **adapter.constants()} for adapter in group.adapters],
            }
            for name, group in zip(agent_names(actors), kinds, strict=True)
        },
    }


def _network(actors: TeamActors) -> dict[str, Any]:
    """Return the description's format, and what a network computes."""
    if actors.module is None:
        return {"format": FORMATS[actors.memory], "network": NETWORKS[actors.memory]}
    plugin, network = plugins.network(actors.module.name)
    return {
        "format": MODULES,
        "network": f"z = {network.module}(shift + scale o), or of an image o / 255, channels first",
        "module": {"plugin": plugin, "options": asdict(actors.module)},
    }


def tensor_names(config: RunConfig, group: GroupSpec) -> TensorNames:
    """Return the environment's names of a type's observations and actions, or numbered names if it has none."""
    farm = farm_of(config)
    known = {} if farm is None else farm_environment(farm).tensor_names
    if group.name in known:
        return known[group.name]
    masks = group.options if group.masked else 0
    seen = tuple(f"observation_{index}" for index in range(group.observation_size - masks))
    legal = tuple(f"mask_{index}" for index in range(masks))
    word = "option" if group.choices else "action"
    return TensorNames((*seen, *legal), tuple(f"{word}_{index}" for index in range(group.environment_action_size)))


def export_safetensors(folder: Path, config: RunConfig, actors: TeamActors, metadata: Mapping[str, str]) -> list[Path]:
    """Write actors.safetensors with the tensors AGENT.LAYER, and actors.json; return the files.

    Raises:
        PolicyError: a file cannot be written.
    """
    text = json.dumps(description(config, actors, metadata), indent=2)
    tensors = {
        f"{name}.{layer}": array
        for name, layers in zip(agent_names(actors), agent_layers(actors), strict=True)
        for layer, array in layers.items()
    }
    data = save(tensors, metadata={"description": text})
    return [_write(folder, "actors.safetensors", data), _describe(folder, text)]


def export_onnx(folder: Path, config: RunConfig, actors: TeamActors, metadata: Mapping[str, str]) -> list[Path]:
    """Write one model for each agent, AGENT.onnx, and actors.json; return the files.

    A model takes `observation` [batch, o] and returns `action` [batch, a], both float32; it holds the choice among
    options and the action adapters. A model with memory also takes `state` and returns `next_state`, both [batch, h].
    Agents that share their parameters have a model each, so that each vehicle needs only its own file.

    Raises:
        PolicyError: the package onnx is missing, or a file cannot be written.
    """
    described = description(config, actors, metadata)
    if actors.module is not None:
        return _export_modules(folder, actors, actors.module, described)
    paths = []
    for name, layers, group in zip(agent_names(actors), agent_layers(actors), kinds_of(actors), strict=True):
        model = _model(name, network_nodes(layers, actors.memory), group, _of_agent(described, name))
        paths.append(_write(folder, f"{name}.onnx", model.SerializeToString()))
    return [*paths, _describe(folder, json.dumps(described, indent=2))]


def _export_modules(folder: Path, actors: TeamActors, module: NetworkConfig, described: dict[str, Any]) -> list[Path]:
    """Write the models of a plug-in's networks, as `export_onnx` does."""
    onnx = _onnx()
    from eia_sec.deploy.policies import onnx_modules  # noqa: PLC0415  (loads torch)

    paths = []
    for name, (group, row) in zip(agent_names(actors), _rows(actors), strict=True):
        graph = onnx_modules.module_graph(module, group, row)
        acting, constants = action_nodes(group)
        graph.name = name
        graph.node.extend(onnx.helper.make_node(n.operator, n.inputs, [n.output], **n.attributes) for n in acting)
        graph.initializer.extend(onnx.numpy_helper.from_array(array, key) for key, array in constants.items())
        size = group.environment_action_size
        output = onnx.helper.make_tensor_value_info("action", onnx.TensorProto.FLOAT, ["batch", size])
        graph.output[0].CopyFrom(output)
        versions = onnx_modules.OPSET, onnx_modules.IR_VERSION
        model = _finished(graph, versions, _of_agent(described, name))
        paths.append(_write(folder, f"{name}.onnx", model.SerializeToString()))
    return [*paths, _describe(folder, json.dumps(described, indent=2))]


def _of_agent(described: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return what the description says about all agents, and about one."""
    shared = {key: value for key, value in described.items() if key != "agents"}
    return {**shared, **described["agents"][name]}


def _describe(folder: Path, text: str) -> Path:
    return _write(folder, "actors.json", f"{text}\n".encode())


def _write(folder: Path, name: str, data: bytes) -> Path:
    try:
        return contained_files.write(folder, name, data, 0o644)
    except OSError as error:
        raise PolicyError(f"{folder / name} cannot be written: {error.strerror}.") from error


def _model(name: str, network: Network, group: GroupSpec, described: Mapping[str, Any]) -> "ModelProto":
    onnx = _onnx()
    helper = onnx.helper
    acting, constants = action_nodes(group)
    inputs, outputs = {"observation": group.observation_size}, {"action": group.environment_action_size}
    if network.state:
        inputs[STATE], outputs[NEXT_STATE] = network.state, network.state
    graph = helper.make_graph(
        [helper.make_node(n.operator, n.inputs, [n.output], **n.attributes) for n in (*network.nodes, *acting)],
        name,
        [helper.make_tensor_value_info(key, onnx.TensorProto.FLOAT, ["batch", size]) for key, size in inputs.items()],
        [helper.make_tensor_value_info(key, onnx.TensorProto.FLOAT, ["batch", size]) for key, size in outputs.items()],
        [onnx.numpy_helper.from_array(array, key) for key, array in (network.numbers | constants).items()],
    )
    return _finished(graph, (OPSET, IR_VERSION), described)


def _finished(graph: Any, versions: tuple[int, int], described: Mapping[str, Any]) -> "ModelProto":
    """Return the checked model of a graph, with what the description says in it.

    Args:
        graph: the graph.
        versions: of its operator set, and of the file.
        described: what the description says about the agent.
    """
    onnx = _onnx()
    helper = onnx.helper
    sets = [helper.make_opsetid("", versions[0])]
    model: ModelProto = helper.make_model(graph, producer_name="eia-sec", opset_imports=sets, ir_version=versions[1])
    helper.set_model_props(model, {k: v if isinstance(v, str) else json.dumps(v) for k, v in described.items()})
    onnx.checker.check_model(model, full_check=True)
    return model


def _onnx() -> Any:
    """Return the package onnx; raise PolicyError if it is missing."""
    try:
        import onnx  # noqa: PLC0415 - an extra that few users need
        import onnx.numpy_helper  # noqa: PLC0415 - the same extra
    except ImportError:
        raise PolicyError("ONNX export needs the package onnx: pip install 'eia-sec[export]'.") from None
    return onnx
