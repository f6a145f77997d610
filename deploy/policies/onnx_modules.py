"""A plug-in's network as an ONNX graph, from an agent's observation to its actor's last layer."""

import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import torch
from torch import Tensor, nn

from eia_sec.common import plugins
from eia_sec.common.actors import actor_outputs
from eia_sec.common.config import NetworkConfig
from eia_sec.common.errors import PolicyError
from eia_sec.common.module_trials import alike, called
from eia_sec.common.modules import FlatModule
from eia_sec.common.team import Float32, GroupSpec
from eia_sec.deploy.policies.onnx_actions import LAST

if TYPE_CHECKING:
    from onnx import GraphProto

OPSET: Final = 17
"""Operator set of these models, the first with layer normalisation."""
INPUT: Final = ("input.shift", "input.scale")
"""Names of what a vector is scaled by."""
IR_VERSION: Final = 8
"""ONNX file version for this operator set."""


class _Actor(nn.Module):
    """An actor that reads rows of observations [B, o]; returns logits, or actions before the tanh."""

    def __init__(self, module: FlatModule, flat: Float32, outputs: int) -> None:
        super().__init__()
        self._inputs, self.outputs = module.inputs, outputs
        self.network = module.filled(torch.from_numpy(flat))
        self.affine = nn.ParameterList(module.affine(torch.from_numpy(flat)))

    def forward(self, x: Tensor) -> Tensor:
        found: Tensor = self.network(self._inputs(list(self.affine), x))
        return found[:, : self.outputs]


def module_layers(options: NetworkConfig, group: GroupSpec, flat: Float32) -> dict[str, Float32]:
    """Return the parameters [P] of an actor by their names in its module, and what its input is scaled by.

    These are `input.shift` and `input.scale`.

    Raises:
        PolicyError: the module has a parameter of such a name.
    """
    module = FlatModule(options, group.seen, actor_outputs(group, "gaussian"))
    row = torch.from_numpy(flat)
    scaled, named = dict(zip(INPUT, module.affine(row), strict=False)), module.named(row)
    if taken := scaled.keys() & named.keys():
        raise PolicyError(f"{module.what} has a parameter {min(taken)}, which is what its input is scaled by here.")
    return {name: tensor.numpy().copy() for name, tensor in (scaled | named).items()}


def module_graph(options: NetworkConfig, group: GroupSpec, flat: Float32) -> "GraphProto":
    """Return an actor's graph from `observation` [batch, o] to LAST.

    Args:
        options: the network's options.
        group: the agent's type.
        flat: [P] its parameters.

    Raises:
        PolicyError: torch cannot write the network as ONNX, or the graph does something else than the network.
    """
    import onnx  # noqa: PLC0415  (an extra that few users need)

    module = FlatModule(options, group.seen, actor_outputs(group, "gaussian"))
    actor = _Actor(module, flat, group.options or group.action_size).eval()
    try:
        with warnings.catch_warnings(record=True) as noted, tempfile.TemporaryDirectory() as folder:
            warnings.simplefilter("always")
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
            _require_traced(noted)
            _require_alike(path, actor, *called(module, torch.from_numpy(flat), group.seen))
            return onnx.load(path).graph
    except Exception as error:  # what torch raises for an operation that ONNX lacks differs from version to version
        plugin, _ = plugins.network(options.name)
        reason = (str(error).strip().splitlines() or [""])[0][:300]
        raise PolicyError(
            f"torch cannot write the network {options.name} of the plug-in {plugin} as ONNX ({reason}); "
            "--format safetensors writes its parameters."
        ) from error


def _require_traced(noted: Sequence[warnings.WarningMessage]) -> None:
    """Raise ValueError for what a user's module computes in Python, which a graph has as a constant.

    Torch's own layers do so with shapes that do not change.
    """
    own = str(Path(torch.__file__).parent)
    for each in noted:
        tracer = torch.jit.TracerWarning  # type: ignore[attr-defined]  # torch has it there, but not in its __all__
        if issubclass(each.category, tracer) and not each.filename.startswith(own):
            where = f"{Path(each.filename).name}, line {each.lineno}"
            raise ValueError(
                f"{where} takes numbers or a length out of tensors, which a graph would hold as constants; x.shape "
                "gives lengths that it computes"
            )


@torch.no_grad()
def _require_alike(path: Path, actor: _Actor, rows: Tensor, found: Tensor) -> None:
    """Raise ValueError unless a graph returns the outputs found for one and for several inputs."""
    import onnxruntime  # noqa: PLC0415  (an extra that few users need)

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4  # the sentence says enough
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    size = session.get_inputs()[0].shape[1]
    seen = torch.cat([rows.float(), torch.ones(len(rows), size - rows.shape[1])], dim=1)
    for part in (slice(0, 1), slice(1, 4)):
        wanted = found[part, : actor.outputs]
        try:
            (returned,) = session.run([LAST], {"observation": seen[part].numpy()})
        except Exception as error:  # onnxruntime has its own for each mistake
            raise ValueError(f"its graph takes no batch of {len(wanted)}") from error
        if returned.shape != wanted.shape or not alike(wanted, torch.from_numpy(returned)):
            raise ValueError(f"its graph returns something else than the network for a batch of {len(wanted)}")
