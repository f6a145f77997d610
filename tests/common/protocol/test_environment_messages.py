"""Messages of served environments: what one side writes the other reads, and nothing else is read."""

import random

import msgpack
import pytest

from eia_sec.common.errors import SchemaError
from eia_sec.common.protocol.environment_messages import (
    MESSAGES,
    MOST_ENTRIES,
    ClaimAnswer,
    ClaimRequest,
    LeaseRequest,
    PlainMessage,
    StepAnswer,
    StepRequest,
)


@pytest.mark.parametrize("kind", MESSAGES)
def test_a_message_is_read_as_it_was_written(kind: type[PlainMessage]) -> None:
    """Every type survives, and each field has a default, which a missing field gets."""
    assert kind.decode(kind().encode()) == kind()
    assert kind.decode(msgpack.packb({"a field of a later version": 1})) == kind()


@pytest.mark.parametrize(
    "fields",
    [
        {"lease": -1},
        {"lease": 2**63},
        {"lease": 1.0},
        {"lease": True},
        {"lease": "1"},
        {"copies": {}},
        {"copies": None},
        {"copies": [0] * (MOST_ENTRIES + 1)},
    ],
    ids=lambda fields: str(fields)[:30],
)
def test_a_field_of_another_type_or_range_is_refused(fields: object) -> None:
    """Numbers are whole, not negative and below 2^63; lists are lists with a limit."""
    with pytest.raises(SchemaError):
        StepRequest.decode(msgpack.packb(fields), 2**20)


def test_a_message_beyond_its_limit_is_not_unpacked() -> None:
    """The length is checked before anything else."""
    with pytest.raises(SchemaError, match="more than 65536"):
        ClaimRequest.decode(bytes(65_537))
    with pytest.raises(SchemaError, match="more than 10"):
        StepAnswer.decode(bytes(11), 10)


def test_mutated_messages_are_read_or_refused() -> None:
    """Whatever is flipped, cut or added, decoding ends with a message or a SchemaError."""
    chance = random.Random(4)
    whole = [
        ClaimRequest("run/0", 5).encode(),
        StepRequest(7, 1, 2, [{"a": b"1234"}, None, 5]).encode(),
        StepAnswer("done", "", 2, [{"rewards": {"a": 1.0}}]).encode(),
        ClaimAnswer("done", "", 7, 1, 15.0, 2, ["a"], [{"type": "discrete", "n": 2, "start": 0}], [{}]).encode(),
        LeaseRequest(7, 1).encode(),
    ]
    refused = 0
    for _ in range(20_000):
        data = bytearray(chance.choice(whole))
        for _ in range(chance.randrange(1, 4)):
            data[chance.randrange(len(data))] = chance.randrange(256)
        try:
            chance.choice(MESSAGES).decode(bytes(data[: chance.randrange(len(data) + 1)]))
        except SchemaError:
            refused += 1
    assert refused > 1000
