"""From an actor's last layer to the environment's action, as nodes of an ONNX graph.

The operations and their order are those of `eia_sec.common.actors` and `eia_sec.common.actions.adapters`.
"""

from collections.abc import Callable, Mapping
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.actions.adapters import (
    GAIN,
    POSITION,
    SIGNS,
    ActionAdapter,
    Headings,
    Lattice,
    MirroredAxes,
    NineMoves,
)
from eia_sec.common.actions.lattice import EDGE
from eia_sec.common.actions.sampling import ILLEGAL
from eia_sec.common.team import GroupSpec


class Node(NamedTuple):
    """One node of a graph.

    Attributes:
        operator: name of the ONNX operator.
        inputs: names of its inputs; ACTION is the action so far.
        output: name of its output.
        attributes: the operator's attributes.
    """

    operator: str
    inputs: list[str]
    output: str
    attributes: Mapping[str, Any] = {}


Numbers = dict[str, NDArray[Any]]
ACTION: Final = "action so far"
LAST: Final = "z3"
"""Output of the last layer, [batch, outputs]."""
FLOAT: Final = 1
"""ONNX's number for 32-bit floats."""
INT64: Final = 7
"""ONNX's number for 64-bit integers."""

LATTICE: Final[tuple[Node, ...]] = (
    Node("Slice", ["observation", "begin", "end", "axis"], "position"),
    Node("Add", ["position", "one"], "raised"),
    Node("Mul", ["raised", "half"], "share"),
    Node("Mul", ["share", "count"], "cells"),
    Node("Add", ["cells", "edge"], "entered"),
    Node("Floor", ["entered"], "floored"),
    Node("Max", ["floored", "zero"], "inside"),
    Node("Min", ["inside", "last"], "cell"),
    Node("Mul", [ACTION, "gain"], "asked"),
    Node("Round", ["asked"], "rounded"),
    Node("Clip", ["rounded", "minus", "one"], "step"),
    Node("Add", ["cell", "step"], "beyond"),
    Node("Max", ["beyond", "zero"], "above"),
    Node("Min", ["above", "last"], "goal"),
    Node("Add", ["goal", "inset"], "low edge"),
    Node("Div", ["low edge", "count"], "low"),
    Node("Add", ["goal", "outset"], "high edge"),
    Node("Div", ["high edge", "count"], "high"),
    Node("Max", ["share", "low"], "not before"),
    Node("Min", ["not before", "high"], "wanted"),
    Node("Sub", ["wanted", "share"], "way"),
    Node("Div", ["way", "reach"], "speed"),
    Node("Clip", ["speed", "minus", "one"], "velocity"),
)
NINE_MOVES: Final[tuple[Node, ...]] = (
    Node("Div", [ACTION, "three"], "thirds"),
    Node("Floor", ["thirds"], "along x"),
    Node("Sub", ["along x", "one"], "step x"),
    Node("Mul", ["three", "along x"], "before"),
    Node("Sub", [ACTION, "before"], "along y"),
    Node("Sub", ["along y", "one"], "step y"),
    Node("Concat", ["step x", "step y"], "steps", {"axis": 1}),
)
HEADINGS: Final[tuple[Node, ...]] = (
    Node("Slice", ["observation", "begin", "end", "axis"], "x"),
    Node("Div", ["x", "way"], "place"),
    Node("Floor", ["place"], "cell"),
    Node("Mul", ["half", "cell"], "pairs"),
    Node("Floor", ["pairs"], "pair"),
    Node("Mul", ["two", "pair"], "even"),
    Node("Sub", ["cell", "even"], "rest"),
    Node("Greater", ["rest", "half"], "odd"),
    Node("Greater", ["x", "high"], "at the end"),
    Node("Or", ["odd", "at the end"], "turns"),
    Node("Less", ["x", "low"], "at the start"),
    Node("Not", ["at the start"], "may turn"),
    Node("And", ["turns", "may turn"], "back"),
    Node("Where", ["back", "minus idle", "plus idle"], "drift"),
    Node("Sub", [ACTION, "one"], "after idle"),
    Node("Max", ["after idle", "zero"], "row"),
    Node("Cast", ["row"], "index", {"to": INT64}),
    Node("Gather", ["velocities", "index"], "gathered"),
    Node("Flatten", ["gathered"], "heading"),
    Node("Less", [ACTION, "one"], "idles"),
    Node("Where", ["idles", "drift", "heading"], "velocity"),
)
MIRRORED_AXES: Final[tuple[Node, ...]] = (
    Node("Slice", ["observation", "begin", "end", "axis"], "signs"),
    Node("Less", ["signs", "zero"], "against"),
    Node("Neg", [ACTION], "turned"),
    Node("Where", ["against", "turned", ACTION], "mirrored"),
)


def action_nodes(group: GroupSpec) -> tuple[list[Node], Numbers]:
    """Return the nodes from LAST to `action`, and their constants by name."""
    nodes, numbers = _option_nodes(group) if group.choices else ([Node("Tanh", [LAST], "output")], {})
    action = nodes[-1].output
    for index, adapter in enumerate(group.adapters):
        own, constants = NODES[adapter.kind](adapter)
        names = {name: f"{name}_{index}" for name in [*constants, *(node.output for node in own)]}
        names |= {ACTION: action, "observation": "observation"}
        nodes += [node._replace(inputs=[names[i] for i in node.inputs], output=names[node.output]) for node in own]
        numbers |= {names[name]: value for name, value in constants.items()}
        action = nodes[-1].output
    nodes[-1] = nodes[-1]._replace(output="action")
    return nodes, numbers


def _option_nodes(group: GroupSpec) -> tuple[list[Node], Numbers]:
    """Return the nodes from logits to the index of each branch's legal option with the largest one."""
    nodes, logits = [], LAST
    numbers: Numbers = {"branch axis": np.array([1])}
    if group.masked:
        numbers["half legal"], numbers["illegal"] = np.array(0.5, np.float32), np.array(ILLEGAL, np.float32)
        numbers["mask begin"] = np.array([group.observation_size - group.options])
        numbers["mask end"] = np.array([group.observation_size])
        nodes += [
            Node("Slice", ["observation", "mask begin", "mask end", "branch axis"], "mask"),
            Node("Greater", ["mask", "half legal"], "legal"),
            Node("Where", ["legal", LAST, "illegal"], "legal logits"),
        ]
        logits = "legal logits"
    start = 0
    for branch, options in enumerate(group.choices):
        numbers[f"begin {branch}"], numbers[f"end {branch}"] = np.array([start]), np.array([start + options])
        nodes.append(Node("Slice", [logits, f"begin {branch}", f"end {branch}", "branch axis"], f"logits {branch}"))
        nodes.append(Node("ArgMax", [f"logits {branch}"], f"option {branch}", {"axis": 1}))
        start += options
    names = [f"option {branch}" for branch in range(len(group.choices))]
    nodes.append(Node("Concat", names, "options", {"axis": 1}))
    nodes.append(Node("Cast", ["options"], "output", {"to": FLOAT}))
    return nodes, numbers


def _lattice(adapter: ActionAdapter) -> tuple[tuple[Node, ...], Numbers]:
    assert isinstance(adapter, Lattice)
    count = np.array([adapter.columns, adapter.rows], np.float32)
    scalars = {"one": 1.0, "half": 0.5, "zero": 0.0, "minus": -1.0, "edge": EDGE, "gain": GAIN}
    scalars |= {"inset": adapter.inset, "outset": float(np.float32(1) - np.float32(adapter.inset))}
    return LATTICE, {
        **{name: np.array(value, np.float32) for name, value in scalars.items()},
        **_bounds(POSITION),
        **{"count": count, "last": count - np.float32(1)},
        "reach": np.array([adapter.reach_x, adapter.reach_y], np.float32),
    }


def _nine_moves(_: ActionAdapter) -> tuple[tuple[Node, ...], Numbers]:
    return NINE_MOVES, {"three": np.array(3.0, np.float32), "one": np.array(1.0, np.float32)}


def _headings(adapter: ActionAdapter) -> tuple[tuple[Node, ...], Numbers]:
    assert isinstance(adapter, Headings)
    one, idle = np.float32(1), np.array([[adapter.idle, 0.0]], np.float32)
    scalars = {"one": 1.0, "zero": 0.0, "half": 0.5, "two": 2.0}
    scalars |= {"way": float(adapter.way), "high": float(one - adapter.way), "low": float(adapter.way - one)}
    return HEADINGS, {
        **{name: np.array(value, np.float32) for name, value in scalars.items()},
        **{"minus idle": -idle, "plus idle": idle},
        **_bounds(slice(0, 1)),
        "velocities": adapter.velocities(),
    }


def _mirrored_axes(_: ActionAdapter) -> tuple[tuple[Node, ...], Numbers]:
    return MIRRORED_AXES, {**_bounds(SIGNS), "zero": np.array(0.0, np.float32)}


def _bounds(part: slice) -> Numbers:
    return {"begin": np.array([part.start]), "end": np.array([part.stop]), "axis": np.array([1])}


NODES: Final[dict[str, Callable[[ActionAdapter], tuple[tuple[Node, ...], Numbers]]]] = {
    Lattice.kind: _lattice,
    MirroredAxes.kind: _mirrored_axes,
    NineMoves.kind: _nine_moves,
    Headings.kind: _headings,
}
"""The nodes and constants of each kind of adapter. The last node returns the adapted action."""
