"""`common.lattice.Lattice.steer` as nodes of an ONNX graph, in the same order of operations."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from common.lattice import EDGE, GAIN, Lattice

STEERING: Final = (
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
    ("Clip", ["speed", "minus", "one"], "action"),
)
"""Operator, inputs and output of every node between the network's `output` and the `action`."""


def steering_numbers(lattice: Lattice) -> dict[str, NDArray[Any]]:
    """Return the constants of the nodes by name."""
    count = np.array([lattice.columns, lattice.rows], np.float32)
    scalars = {"one": 1.0, "half": 0.5, "zero": 0.0, "minus": -1.0, "edge": EDGE, "gain": GAIN}
    return {
        **{name: np.array(value, np.float32) for name, value in scalars.items()},
        **{"begin": np.array([0]), "end": np.array([2]), "axis": np.array([1])},
        **{"count": count, "last": count - np.float32(1)},
        "reach": np.array([lattice.reach_x, lattice.reach_y], np.float32),
    }
