"""`common.team.TeamSpec.steer` as nodes of an ONNX graph, in the same order of operations."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from common.lattice import EDGE, GAIN, Lattice
from common.team import PLACE, SIGNS, GroupSpec

Node = tuple[str, list[str], str]
"""Operator, inputs and output."""
LATTICE: Final[tuple[Node, ...]] = (
    ("Slice", ["observation", "begin", "end", "axis"], "place"),
    ("Add", ["place", "one"], "raised"),
    ("Mul", ["raised", "half"], "share"),
    ("Mul", ["share", "count"], "cells"),
    ("Add", ["cells", "edge"], "entered"),
    ("Floor", ["entered"], "floored"),
    ("Max", ["floored", "zero"], "inside"),
    ("Min", ["inside", "last"], "cell"),
    ("Mul", ["output", "gain"], "asked"),
    ("Round", ["asked"], "rounded"),
    ("Clip", ["rounded", "minus", "one"], "step"),
    ("Add", ["cell", "step"], "beyond"),
    ("Max", ["beyond", "zero"], "above"),
    ("Min", ["above", "last"], "goal"),
    ("Add", ["goal", "half"], "middle"),
    ("Div", ["middle", "count"], "wanted"),
    ("Sub", ["wanted", "share"], "way"),
    ("Div", ["way", "reach"], "speed"),
    ("Clip", ["speed", "minus", "one"], "led"),
)
"""The nodes between the network's `output` and what the lattice makes of it."""
MIRROR: Final[tuple[Node, ...]] = (
    ("Slice", ["observation", "first_sign", "last_sign", "axis"], "signs"),
    ("Less", ["signs", "zero"], "against"),
)
"""The nodes that say whose axes point against the field's."""


def steering(group: GroupSpec) -> tuple[list[Node], dict[str, NDArray[Any]]]:
    """Return the nodes between the network's `output` and the `action`, and their constants by name.

    There are none where the output is the action.
    """
    nodes: list[Node] = []
    numbers: dict[str, NDArray[Any]] = {}
    if group.lattice is not None:
        nodes += LATTICE
        numbers |= _lattice_numbers(group.lattice)
    if group.mirrored:
        along = nodes[-1][2] if nodes else "output"
        nodes += [*MIRROR, ("Neg", [along], "turned"), ("Where", ["against", "turned", along], "action")]
        numbers |= {"first_sign": np.array([SIGNS.start]), "last_sign": np.array([SIGNS.stop]), "axis": np.array([1])}
        numbers["zero"] = np.array(0.0, np.float32)
    if nodes:
        kind, taken, _ = nodes[-1]
        nodes[-1] = kind, taken, "action"
    return nodes, numbers


def _lattice_numbers(lattice: Lattice) -> dict[str, NDArray[Any]]:
    count = np.array([lattice.columns, lattice.rows], np.float32)
    scalars = {"one": 1.0, "half": 0.5, "zero": 0.0, "minus": -1.0, "edge": EDGE, "gain": GAIN}
    return {
        **{name: np.array(value, np.float32) for name, value in scalars.items()},
        **{"begin": np.array([PLACE.start]), "end": np.array([PLACE.stop]), "axis": np.array([1])},
        **{"count": count, "last": count - np.float32(1)},
        "reach": np.array([lattice.reach_x, lattice.reach_y], np.float32),
    }
