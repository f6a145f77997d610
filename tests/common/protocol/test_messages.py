"""Every message type survives the wire, and nothing that differs from its declaration is accepted."""

import dataclasses

import numpy as np
import pytest

from eia_sec.common.errors import FrameError, SchemaError
from eia_sec.common.protocol import frame, messages
from eia_sec.common.protocol.codec import Message
from eia_sec.common.protocol.messages import (
    ChunkAck,
    ChunkMessage,
    DeliveryMessage,
    EvaluationOrder,
    EvaluationResult,
    ExploitMessage,
    ImitationMessage,
    MetricMessage,
    ParametersMessage,
    PoseMessage,
    ProgressMessage,
    SetpointMessage,
    StepsMessage,
    ViewMessage,
    WatchRequest,
    WatchTerms,
)

TYPES = [
    kind
    for kind in vars(messages).values()
    if isinstance(kind, type) and issubclass(kind, Message) and kind is not Message
]

EXAMPLES = [
    ChunkAck(("accepted", "refused"), ("", "why"), 4, 0),
    DeliveryMessage(3, 40, (1000, 2000)),
    EvaluationOrder(9, 1, 2, (3, 4), (5, 6)),
    EvaluationResult(1, 2, np.ones((2, 5, 3), np.float32), np.array([5, 3], np.int64)),
    ImitationMessage(9, 1, 2, 10, 0.1, (0, 1), ((0.5, -1.0), (2.0,)), 500),
    MetricMessage(1, "host", 2, 3.0, {"a": {"b": 1.5}, "c": "text"}),
    ParametersMessage(
        1, 2, 0, 4, 0.5, "ab", 8, "gaussian", (np.ones((2, 3), np.float32), np.zeros((1, 7), np.float32))
    ),
    ParametersMessage(1, 2, 0, 4, 0.5, "ab", 8, "gaussian", (np.ones((2, 3), np.float32),), "gru"),
    ChunkMessage(
        *("ab", 1, 2),
        *(np.ones((3, size), np.float32) for size in (4, 2, 1)),
        flag=np.ones(3, np.uint8),
        log_probability=np.ones((3, 1), np.float32),
        **dict.fromkeys(("farm", "episode", "steps"), np.zeros(0, np.int64)),
        episode_reward=np.zeros((0, 1), np.float32),
        episode_metrics=np.zeros((0, 0), np.float64),
        metric_names=(),
        state=np.full((1, 2, 8), 0.5, np.float32),
    ),
    ProgressMessage(1, 2, 3, 4, 5, 6, "training"),
    PoseMessage(
        *("monitoring_1", 1_700_000_000_000_000, (12.5, 300.0), False, 20.0, (1.0, -2.0), (0.5, 0.0), (), 1e5, ()),
        *(False, 7, "main", 3, ""),
        served=np.arange(3, dtype=np.int32),
        served_stamp=np.arange(3, dtype=np.int64),
    ),
    SetpointMessage(
        *("monitoring_1", (1.25, -10.0), (13.75, 290.0), 20.0, 0.0, (0.125, -1.0)),
        *(False, "", 7, 9, 0.5, 1_700_000_000_000_000, 0.0004, 5),
    ),
    WatchRequest("somebody", True),
    WatchTerms("seed = 1", ("energy", "utility"), 4.0, 25.0),
    WatchTerms("seed = 1", (), 4.0, 25.0, ("a", "b"), {"groups": []}),
    StepsMessage(
        *(1, 2, 3, 4, 0.5, False),
        reward=np.ones((2, 3), np.float32),
        action=np.ones((2, 4), np.float32),
        seen=np.zeros((2, 3, 3), np.float32),
        alive=np.ones((2, 3), np.uint8),
        pictures=np.arange(5, dtype=np.uint8),
        ends=np.array([0, 5]),
        silence="",
    ),
    ViewMessage(
        *(1, 2, 3, 4, 0.5, False),
        position=np.ones((2, 3, 2), np.float32),
        assignment=np.zeros((2, 2), np.uint8),
        quality=np.ones((2, 2), np.float32),
        aoi=np.full((2, 5), 51, np.uint8),
        vdf=np.zeros((2, 2, 2), np.uint8),
        level=np.ones((2, 2), np.float32),
        parts=np.zeros((2, 3, 7), np.float32),
    ),
    EvaluationOrder(9, 1, 2, (3, 4), (5, 6), (np.ones((1, 2), np.float32), np.ones((2, 2), np.float32))),
]
EXAMPLES.append(
    ExploitMessage(
        *(9, 2, 1.0, {"member-0": 0.5, "member-1": 0.25}, ("member-0", "")),
        flat=(np.ones((2, 3), np.float32), np.zeros((0, 0), np.float32)),
        hyperparameters={"actor_rate": 0.001},
        evaluation_steps=40,
    )
)
EXAMPLES.append(
    dataclasses.replace(
        next(message for message in EXAMPLES if isinstance(message, ViewMessage)),
        gone=np.zeros((2, 3), np.uint8),
        charge=np.full((2, 3), 200, np.uint8),
        known=np.ones((2, 4), np.uint8),
    )
)


def test_every_type_is_a_dataclass_with_a_number_of_its_own() -> None:
    """KIND numbers are unique, and every message is a frozen dataclass."""
    assert len({kind.KIND for kind in TYPES}) == len(TYPES) > 8
    assert all(dataclasses.is_dataclass(kind) for kind in TYPES)


@pytest.mark.parametrize("message", EXAMPLES, ids=lambda message: type(message).__name__)
def test_round_trip(message: Message) -> None:
    """Each field comes back equal and of the same type."""
    again = type(message).decode(message.encode())
    for field in dataclasses.fields(message):  # type: ignore[arg-type]  # every message is a dataclass
        sent, got = getattr(message, field.name), getattr(again, field.name)
        if isinstance(sent, np.ndarray):
            np.testing.assert_array_equal(got, sent)
        elif isinstance(sent, tuple) and sent and isinstance(sent[0], np.ndarray):
            for a, b in zip(sent, got, strict=True):
                np.testing.assert_array_equal(a, b)
        else:
            assert got == sent


def test_a_field_that_is_none_is_left_out():
    """Frames of actors without memory have no field for it."""
    with_memory = next(m for m in EXAMPLES if isinstance(m, ChunkMessage))
    without = dataclasses.replace(with_memory, state=None)
    values = {
        f.name: getattr(without, f.name)
        for f in dataclasses.fields(without)
        if f.name not in ("state", "infos", "info_names")
    }
    arrays = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
    scalars = {name: value for name, value in values.items() if name not in arrays}
    assert without.encode() == frame.encode(ChunkMessage.KIND, scalars, arrays)
    assert ChunkMessage.decode(without.encode()).state is None
    assert len(with_memory.encode()) > len(without.encode()) + 64
    plain = next(m for m in EXAMPLES if isinstance(m, ParametersMessage))
    assert plain.memory is None
    assert b"memory" not in plain.encode()
    view = next(m for m in EXAMPLES if isinstance(m, ViewMessage))
    assert not any(name in view.encode() for name in (b"gone", b"charge", b"known"))
    assert ViewMessage.decode(view.encode()).charge is None


@pytest.mark.parametrize("memory", [None, 7, ["gru"]])
def test_an_optional_field_has_its_type_where_it_is(memory):
    """Nothing but a text is a memory, an explicit null included."""
    plain = next(m for m in EXAMPLES if isinstance(m, ParametersMessage))
    scalars, arrays = frame.decode(plain.encode(), ParametersMessage.KIND)
    with pytest.raises(SchemaError, match="field memory is"):
        ParametersMessage.decode(frame.encode(ParametersMessage.KIND, scalars | {"memory": memory}, arrays))


@pytest.mark.parametrize(
    ("fields", "arrays"),
    [
        ({"event": 1, "version": 2}, {}),
        ({"event": 1, "version": 2}, {"reward": np.ones(3)}),
        ({"event": "1", "version": 2}, {"reward": np.ones(3, np.float32)}),
        ({"event": True, "version": 2}, {"reward": np.ones(3, np.float32)}),
        ({"event": -1, "version": 2}, {"reward": np.ones(3, np.float32)}),
        ({"event": 1}, {"reward": np.ones(3, np.float32)}),
        ({"event": 1, "version": 2, "more": 3}, {"reward": np.ones(3, np.float32)}),
        ({"event": 1, "version": 2}, {"reward": np.ones(3, np.float32), "more": np.ones(1)}),
    ],
)
def test_what_differs_from_the_declaration_is_refused(
    fields: dict[str, object], arrays: dict[str, frame.Array]
) -> None:
    """Missing, unknown, mistyped and out-of-range fields are SchemaErrors."""
    with pytest.raises(SchemaError):
        EvaluationResult.decode(frame.encode(EvaluationResult.KIND, fields, arrays))


@pytest.mark.parametrize("rate", [float("nan"), float("inf")])
def test_numbers_that_are_not_finite_are_refused(rate: float) -> None:
    """A NaN or an infinity in a scalar field is a SchemaError."""
    message = dataclasses.replace(EXAMPLES[4], rate=rate)  # type: ignore[type-var]  # an ImitationMessage
    with pytest.raises(SchemaError, match="finite"):
        ImitationMessage.decode(message.encode())


@pytest.mark.parametrize("kind", TYPES)
def test_a_long_header_is_refused_before_it_is_unpacked(kind, monkeypatch):
    """Each kind has its limit, far below a frame's, but for those that hold a configuration."""

    def unpack(*arguments, **options):
        raise AssertionError("unpacked")

    data = frame.encode(kind.KIND, {"x": [{}] * kind.MOST_HEADER}, {}) if kind.MOST_HEADER < frame.MAX_HEADER else b""
    monkeypatch.setattr(frame.msgpack, "unpackb", unpack)
    assert (kind in (messages.ConfigurationMessage, messages.WatchTerms)) == (not data)
    with pytest.raises(FrameError):
        kind.decode(data)


def test_an_imitation_event_holds_the_scores_of_a_large_team():
    """Its header grows with the agents, and is still read."""
    message = ImitationMessage(9, 1, 2, 10, 0.1, (0,), ((0.5,) * 20_000,), 500)
    assert ImitationMessage.decode(message.encode()) == message
