"""The action adapters of `common.action_adapters` as nodes of an ONNX graph, in the same order of operations."""

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from common.action_adapters import EDGE, GAIN, POSITION, SIGNS, ActionAdapter, Lattice, MirroredAxes
from common.team import GroupSpec

Node = tuple[str, list[str], str]
"""Operator, inputs and output; the input ACTION is the action so far."""
Numbers = dict[str, NDArray[Any]]
ACTION: Final = "action so far"

LATTICE: Final[tuple[Node, ...]] = (
    ("Slice", ["observation", "begin", "end", "axis"], "position"),
    ("Add", ["position", "one"], "raised"),
    ("Mul", ["raised", "half"], "share"),
    ("Mul", ["share", "count"], "cells"),
    ("Add", ["cells", "edge"], "entered"),
    ("Floor", ["entered"], "floored"),
    ("Max", ["floored", "zero"], "inside"),
    ("Min", ["inside", "last"], "cell"),
    ("Mul", [ACTION, "gain"], "asked"),
    ("Round", ["asked"], "rounded"),
    ("Clip", ["rounded", "minus", "one"], "step"),
    ("Add", ["cell", "step"], "beyond"),
    ("Max", ["beyond", "zero"], "above"),
    ("Min", ["above", "last"], "goal"),
    ("Add", ["goal", "half"], "middle"),
    ("Div", ["middle", "count"], "wanted"),
    ("Sub", ["wanted", "share"], "way"),
    ("Div", ["way", "reach"], "speed"),
    ("Clip", ["speed", "minus", "one"], "velocity"),
)
MIRRORED_AXES: Final[tuple[Node, ...]] = (
    ("Slice", ["observation", "begin", "end", "axis"], "signs"),
    ("Less", ["signs", "zero"], "against"),
    ("Neg", [ACTION], "turned"),
    ("Where", ["against", "turned", ACTION], "mirrored"),
)


def adapter_nodes(group: GroupSpec) -> tuple[list[Node], Numbers]:
    """Return the nodes between the network's `output` and the `action`, and their constants by name.

    There are none if the output is the action.
    """
    nodes: list[Node] = []
    numbers: Numbers = {}
    action = "output"
    for index, adapter in enumerate(group.adapters):
        own, constants = NODES[adapter.kind](adapter)
        names = {name: f"{name}_{index}" for name in [*constants, *(given for _, _, given in own)]}
        names |= {ACTION: action, "observation": "observation"}
        nodes += [(kind, [names[name] for name in taken], names[given]) for kind, taken, given in own]
        numbers |= {names[name]: value for name, value in constants.items()}
        action = nodes[-1][2]
    if nodes:
        kind, taken, _ = nodes[-1]
        nodes[-1] = kind, taken, "action"
    return nodes, numbers


def _lattice(adapter: ActionAdapter) -> tuple[tuple[Node, ...], Numbers]:
    assert isinstance(adapter, Lattice)
    count = np.array([adapter.columns, adapter.rows], np.float32)
    scalars = {"one": 1.0, "half": 0.5, "zero": 0.0, "minus": -1.0, "edge": EDGE, "gain": GAIN}
    return LATTICE, {
        **{name: np.array(value, np.float32) for name, value in scalars.items()},
        **_bounds(POSITION),
        **{"count": count, "last": count - np.float32(1)},
        "reach": np.array([adapter.reach_x, adapter.reach_y], np.float32),
    }


def _mirrored_axes(_: ActionAdapter) -> tuple[tuple[Node, ...], Numbers]:
    return MIRRORED_AXES, {**_bounds(SIGNS), "zero": np.array(0.0, np.float32)}


def _bounds(part: slice) -> Numbers:
    return {"begin": np.array([part.start]), "end": np.array([part.stop]), "axis": np.array([1])}


NODES: Final[dict[str, Callable[[ActionAdapter], tuple[tuple[Node, ...], Numbers]]]] = {
    Lattice.kind: _lattice,
    MirroredAxes.kind: _mirrored_axes,
}
"""The nodes and constants of each kind of adapter. The last node returns the adapted action."""
