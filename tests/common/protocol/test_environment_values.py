"""Spaces and values of served environments travel as they are, and nothing else is taken for one."""

from typing import Any

import msgpack
import numpy as np
import pytest
from gymnasium import spaces

from eia_sec.common.errors import SchemaError
from eia_sec.common.protocol.environment_values import described, form_of
from eia_sec.rollout.remote.served import space_of

SPACES = [
    spaces.Box(-1.0, 1.0, (3,), np.float32),
    spaces.Box(np.array([-1.0, 0.0]), np.array([np.inf, 2.0]), dtype=np.float64),
    spaces.Box(0, 255, (4, 4, 3), np.uint8),
    spaces.Box(-1.0, 1.0, (), np.float32),
    spaces.Discrete(5, start=-2),
    spaces.MultiDiscrete([3, 2], start=[1, 0]),
    spaces.MultiBinary(6),
    spaces.Dict({"action_mask": spaces.Box(0, 1, (5,), np.int8), "view": spaces.Box(0.0, 1.0, (2, 2))}),
    spaces.Tuple((spaces.Discrete(2), spaces.Box(0.0, 1.0, (2,)))),
]
BOX = {"type": "box", "dtype": "<f4", "shape": [2], "low": 0, "high": 1}


@pytest.mark.parametrize("space", SPACES, ids=str)
def test_a_space_and_its_values_arrive_as_they_were(space: spaces.Space[Any]) -> None:
    """Described, sent and made again, a space equals itself, and so do values drawn from it."""
    sent = msgpack.unpackb(msgpack.packb(described(space)))
    form = form_of(sent)
    assert space_of(sent) == space
    for seed in range(5):
        space.seed(seed)
        value = space.sample()
        packed = msgpack.packb(form.pack(value))
        assert len(packed) <= form.most
        found = form.unpack(msgpack.unpackb(packed))
        assert space.contains(found) or isinstance(space, spaces.Discrete)
        assert np.array_equal(spaces.flatten(space, found), spaces.flatten(space, value))


@pytest.mark.parametrize(
    "description",
    [
        None,
        {},
        {"type": "box"},
        {**BOX, "dtype": "<c8"},
        {**BOX, "dtype": "object"},
        {**BOX, "dtype": ["<f4"]},
        {**BOX, "shape": [-1]},
        {**BOX, "shape": [2**20, 2**20]},
        {**BOX, "shape": [1] * 9},
        {**BOX, "low": b"short"},
        {**BOX, "low": "0"},
        {"type": "discrete", "n": 0, "start": 0},
        {"type": "discrete", "n": True, "start": 0},
        {"type": "discrete", "n": 2},
        {"type": "multi_discrete", "nvec": [2, 3], "start": [0]},
        {"type": "multi_discrete", "nvec": [1] * 5000, "start": [0] * 5000},
        {"type": "tuple", "spaces": [BOX] * 5000},
        {"type": "dict", "spaces": [["key"]]},
        {"type": "graph"},
    ],
    ids=lambda description: str(description)[:40],
)
def test_other_descriptions_are_refused(description: Any) -> None:
    """A missing field, another type, and sizes beyond the limits are SchemaErrors."""
    with pytest.raises(SchemaError):
        form_of(description)


def test_spaces_within_spaces_have_a_limit() -> None:
    """A description that lies deeper than any environment's is refused."""
    space: Any = BOX
    for _ in range(6):
        space = {"type": "tuple", "spaces": [space]}
    with pytest.raises(SchemaError):
        form_of(space)


@pytest.mark.parametrize(
    ("space", "raw"),
    [
        (BOX, b"1234567"),
        (BOX, [0.0, 1.0]),
        ({"type": "discrete", "n": 3, "start": 0}, 1.0),
        ({"type": "discrete", "n": 3, "start": 0}, 2**63),
        ({"type": "multi_discrete", "nvec": [2, 2], "start": [0, 0]}, [1]),
        ({"type": "multi_discrete", "nvec": [2], "start": [0]}, [2**64]),
        ({"type": "dict", "spaces": [["a", BOX]]}, {"b": b"12345678"}),
        ({"type": "tuple", "spaces": [BOX]}, []),
    ],
)
def test_other_values_are_refused(space: Any, raw: Any) -> None:
    """Bytes of another length, other types and other keys are SchemaErrors."""
    with pytest.raises(SchemaError):
        form_of(space).unpack(raw)


def test_a_space_that_does_not_travel_is_named() -> None:
    """The sentence says which type it is, and which types travel."""
    with pytest.raises(SchemaError, match="type Text cannot be served; use Box, Discrete"):
        described(spaces.Text(5))
