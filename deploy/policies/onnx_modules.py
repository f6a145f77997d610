"""A plug-in's network as an ONNX graph, from an agent's observation to its actor's last layer."""

import tempfile
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import torch
from torch import Tensor, nn

from eia_sec.common import plugins
from eia_sec.common.actors import actor_outputs
from eia_sec.common.config import NetworkConfig
from eia_sec.common.errors import PolicyError
from eia_sec.common.modules import FlatModule
from eia_sec.common.team import Float32, GroupSpec
from eia_sec.deploy.policies.onnx_actions import LAST

if TYPE_CHECKING:
    from onnx import GraphProto

OPSET: Final = 17
"""Operator set of these models, the first with layer normalisation."""
IR_VERSION: Final = 8
"""ONNX file version for this operator set."""


class _Actor(nn.Module):
    """An actor that reads rows of observations [B, o]; returns logits, or actions before the tanh."""

    def __init__(self, module: FlatModule, flat: Float32, outputs: int) -> None:
        super().__init__()
        self._inputs, self._outputs = module.inputs, outputs
        self.network = module.filled(torch.from_numpy(flat))
        self.affine = nn.ParameterList(module.affine(torch.from_numpy(flat)))

    def forward(self, x: Tensor) -> Tensor:
        found: Tensor = self.network(self._inputs(list(self.affine), x))
        return found[:, : self._outputs]


def module_layers(options: NetworkConfig, group: GroupSpec, flat: Float32) -> dict[str, Float32]:
    """Return the parameters [P] of an actor by their names in its module, and `shift` and `scale` of its input."""
    module = FlatModule(options, group.seen, actor_outputs(group, "gaussian"))
    row = torch.from_numpy(flat)
    named: dict[str, Any] = dict(zip(("shift", "scale"), module.affine(row), strict=False)) | module.named(row)
    return {name: tensor.numpy().copy() for name, tensor in named.items()}


def module_graph(options: NetworkConfig, group: GroupSpec, flat: Float32) -> "GraphProto":
    """Return an actor's graph from `observation` [batch, o] to LAST.

    Args:
        options: the network's options.
        group: the agent's type.
        flat: [P] its parameters.

    Raises:
        PolicyError: torch cannot write the network as ONNX.
    """
    import onnx  # noqa: PLC0415 - an extra that few users need

    module = FlatModule(options, group.seen, actor_outputs(group, "gaussian"))
    actor = _Actor(module, flat, group.options or group.action_size).eval()
    try:
        with warnings.catch_warnings(), tempfile.TemporaryDirectory() as folder:
            warnings.simplefilter("ignore")  # torch prefers an exporter that needs another package
            torch.onnx.export(
                actor,
                (torch.zeros(2, group.observation_size),),
                path := Path(folder) / "network.onnx",
                input_names=["observation"],
                output_names=[LAST],
                dynamic_axes={"observation": {0: "batch"}, LAST: {0: "batch"}},
                opset_version=OPSET,
                dynamo=False,
            )
            return onnx.load(path).graph
    except Exception as error:  # what torch raises for an operation that ONNX lacks differs from version to version
        plugin, _ = plugins.network(options.name)
        reason = (str(error).strip().splitlines() or [""])[0][:300]
        raise PolicyError(
            f"torch cannot write the network {options.name} of the plug-in {plugin} as ONNX ({reason}); "
            "--format safetensors writes its parameters."
        ) from error
