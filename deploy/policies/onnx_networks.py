"""From an agent's observation to its actor's last layer, as nodes of an ONNX graph.

The operations and their order are those of `eia_sec.common.actors` and `eia_sec.common.gru`.
"""

from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from eia_sec.common.gru import Memory
from eia_sec.common.team import Float32
from eia_sec.deploy.policies.onnx_actions import LAST, Node, Numbers

STATE: Final = "state"
NEXT_STATE: Final = "next_state"
"""State of an actor with memory before and after the decision, [batch, h]."""

PERCEPTRON: Final[tuple[Node, ...]] = (
    Node("Gemm", ["observation", "w1", "b1"], "z1"),
    Node("Relu", ["z1"], "h1"),
    Node("Gemm", ["h1", "w2", "b2"], "z2"),
    Node("Relu", ["z2"], "h2"),
    Node("Gemm", ["h2", "w3", "b3"], LAST),
)
RECURRENT: Final[tuple[Node, ...]] = (
    Node("Gemm", ["observation", "w1", "b1"], "z1"),
    Node("Relu", ["z1"], "h1"),
    Node("Gemm", ["h1", "w", "b"], "asked"),
    Node("Gemm", [STATE, "u", "c"], "known"),
    Node("Slice", ["asked", "gate 0", "gate 2", "gate axis"], "asked gates"),
    Node("Slice", ["known", "gate 0", "gate 2", "gate axis"], "known gates"),
    Node("Add", ["asked gates", "known gates"], "gates"),
    Node("Sigmoid", ["gates"], "opened"),
    Node("Slice", ["opened", "gate 0", "gate 1", "gate axis"], "reset"),
    Node("Slice", ["opened", "gate 1", "gate 2", "gate axis"], "keep"),
    Node("Slice", ["asked", "gate 2", "gate 3", "gate axis"], "asked candidate"),
    Node("Slice", ["known", "gate 2", "gate 3", "gate axis"], "known candidate"),
    Node("Mul", ["reset", "known candidate"], "seen"),
    Node("Add", ["asked candidate", "seen"], "raw candidate"),
    Node("Tanh", ["raw candidate"], "candidate"),
    Node("Sub", [STATE, "candidate"], "away"),
    Node("Mul", ["keep", "away"], "kept"),
    Node("Add", ["candidate", "kept"], NEXT_STATE),
    Node("Gemm", [NEXT_STATE, "w3", "b3"], LAST),
)


class Network(NamedTuple):
    """An actor's layers as a part of a graph.

    Attributes:
        nodes: the nodes from `observation`, and with memory `state`, to LAST.
        numbers: layers and constants by name.
        state: numbers h in the state; 0 for an actor without memory.
    """

    nodes: tuple[Node, ...]
    numbers: Numbers
    state: int


def network_nodes(layers: Mapping[str, Float32], memory: Memory) -> Network:
    """Return an actor's layers as a part of a graph.

    Args:
        layers: the layers by their names, see `eia_sec.deploy.policies.export.LAYERS`.
        memory: the actor's memory.
    """
    if memory == "none":
        return Network(PERCEPTRON, dict(layers), 0)
    width = len(layers["u"])
    bounds = {f"gate {index}": np.array([index * width]) for index in range(4)}
    return Network(RECURRENT, {**layers, **bounds, "gate axis": np.array([1])}, width)
