"""Frames of every kind of message, requests of several chunks, and ways to spoil them, for the fuzz tests."""

import functools
import random
import struct
from collections.abc import Callable
from dataclasses import replace
from typing import Final

import numpy as np

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import PopulationConfig, RunConfig
from eia_sec.common.errors import ProtocolError
from eia_sec.common.farm import METRIC_NAMES
from eia_sec.common.policy_store import PolicyStore
from eia_sec.common.protocol import codec, frame, messages
from eia_sec.common.protocol.bfloat16 import to_bits
from eia_sec.common.protocol.chunk_messages import from_message, from_request, to_message, to_request
from eia_sec.common.protocol.view_checks import check_steps, check_view
from eia_sec.rollout.sim.batch import REWARD_PARTS
from tests.common.protocol.test_view_checks import CONDITIONS, CONFIG, a_view, a_view_of_conditions, some_steps
from tests.common.protocol.test_view_checks import TEAM as STEPS_TEAM
from tests.faults.tools.channel import TEAM, a_chunk, with_log_probabilities

KINDS: Final = tuple(
    kind for kind in vars(messages).values() if isinstance(kind, type) and issubclass(kind, codec.Message) and kind.KIND
)
_PREFIX: Final = struct.Struct("<4sBBHIQI")
MEMORY: Final = 4
"""Numbers in a state."""


MEMBER = RunConfig(population=PopulationConfig(members=2, rate=0.5, hyperparameters={"actor_rate": (1e-4, 1e-2)}))
"""A member of a population."""


def samples() -> dict[str, bytes]:
    """Return a whole frame of each kind of message by name, a request of two chunks and an on-policy chunk."""
    flat = TeamActors.initial(TEAM, 4, 0).flat
    found = [
        messages.Envelope("rollout", "w", 1, 1, 1),
        to_message(a_chunk(1), TEAM, 1, 1),
        messages.ChunkAck(("accepted",), ("",), 2, 0),
        messages.DeliveryMessage(1, 1, (64, 65)),
        messages.ParametersMessage(1, 1, 0, 10, 0.5, TEAM.digest, 4, "deterministic", flat),
        messages.ProgressMessage(1, 1, 0, 1, 10, 1, "training"),
        messages.CommandMessage("somebody"),
        messages.ConfigurationMessage(1, "seed = 1", TEAM.to_dict(), False),
        messages.ReceiptMessage(True, ""),
        messages.EvaluationOrder(1, 1, 1, (1, 2), (3, 4)),
        messages.EvaluationResult(1, 1, np.zeros((1, 2, 2), np.float32), np.ones(1, np.int64)),
        messages.ImitationMessage(1, 1, 1, 10, 0.1, (0,), ((0.5, 0.25),), 10),
        messages.ExploitMessage(1, 1, 0.5, {"a": 1.0, "b": 2.0}, ("b",), (flat[0],), {"actor_rate": 0.002}, 10),
        messages.PoseMessage(
            *("a_0", 1_700_000_000_000_000, (12.5, 300.0), False, 20.0, (1.0, -2.0), (0.5, 0.0), (), 1e5, ()),
            *(False, 7, "main", 3, ""),
            served=np.arange(3, dtype=np.int32),
            served_stamp=np.arange(3, dtype=np.int64),
        ),
        messages.SetpointMessage(
            *("a_0", (1.25, -10.0), (13.75, 290.0), 20.0, 0.0, (0.125, -1.0)),
            *(False, "", 7, 9, 0.5, 1_700_000_000_000_000, 0.0004, 5),
        ),
        messages.MetricMessage(1, "host", 2, 0.5, {"a": 1, "b": [1.5, "x"], "c": {"d": None}}),
        messages.WatchRequest("somebody", True),
        messages.WatchTerms("seed = 1", ("energy", "utility"), 4.0, 25.0),
        a_view(),
        some_steps(),
    ]
    several = to_request([to_message(a_chunk(number), TEAM, 1, number).encode() for number in (1, 2)], 1, 2)
    logged = with_log_probabilities(a_chunk(1))
    on_policy = to_message(logged, TEAM, 1, 1).encode()
    halved = replace(logged, rows=replace(logged.rows, observation=to_bits(logged.rows.observation)))
    states = np.full((1, TEAM.agents, MEMORY), 0.5, np.float32)
    remembered = replace(logged, rows=replace(logged.rows, state=states))
    actors = TeamActors.initial(TEAM, MEMORY, 0, memory="gru")
    recurrent = messages.ParametersMessage(
        1, 1, 0, 10, 0.5, TEAM.digest, MEMORY, actors.head, actors.flat, actors.memory
    )
    whole = {type(message).__name__: message.encode() for message in found}
    return whole | {
        "request": several,
        "on-policy chunk": on_policy,
        "rounded chunk": to_message(halved, TEAM, 1, 1).encode(),
        "chunk with states": to_message(remembered, TEAM, 1, 1).encode(),
        "actors with memory": recurrent.encode(),
        "view of conditions": a_view_of_conditions().encode(),
    }


def _read(kind: type[codec.Message], data: frame.Data) -> None:
    """Decode a message and put it through the checks behind the decoder; raise ProtocolError when it is none."""
    message = kind.decode(data)
    if isinstance(message, messages.ChunkMessage):
        from_message(message, TEAM, METRIC_NAMES)
    elif isinstance(message, messages.ParametersMessage):
        PolicyStore(TEAM).offer_parameters(message)
    elif isinstance(message, messages.ImitationMessage):
        message.to_event().check(TEAM)
    elif isinstance(message, messages.ExploitMessage):
        message.to_event().check(TEAM, MEMBER)
    elif isinstance(message, messages.ViewMessage):
        check_view(message, CONFIG.farm, len(REWARD_PARTS))
    elif isinstance(message, messages.StepsMessage):
        check_steps(message, STEPS_TEAM)


def _read_request(data: bytes) -> None:
    """Take a request apart and read its chunks; raise ProtocolError when one of them is none."""
    for part in from_request(data)[1]:
        _read(messages.ChunkMessage, part)


def _read_states(data: bytes) -> None:
    """Read a chunk as a learner whose actors have memory does."""
    from_message(messages.ChunkMessage.decode(data), TEAM, METRIC_NAMES, on_policy=True, memory=MEMORY)


def _read_on_policy(data: bytes) -> None:
    """Read a chunk as a learner that learns on policy does."""
    from_message(messages.ChunkMessage.decode(data), TEAM, METRIC_NAMES, on_policy=True)


def _read_rounded(data: bytes) -> None:
    """Read a chunk as a learner in bfloat16 does."""
    from_message(messages.ChunkMessage.decode(data), TEAM, METRIC_NAMES, on_policy=True, rounded=True)


def _read_conditions(data: bytes) -> None:
    """Read a view as a watcher of a farm with batteries, failures and stress does."""
    check_view(messages.ViewMessage.decode(data), CONDITIONS.farm, len(REWARD_PARTS))


READERS: Final[dict[str, Callable[[bytes], None]]] = {
    **{kind.__name__: functools.partial(_read, kind) for kind in KINDS},
    "request": _read_request,
    "on-policy chunk": _read_on_policy,
    "rounded chunk": _read_rounded,
    "chunk with states": _read_states,
    "actors with memory": functools.partial(_read, messages.ParametersMessage),
    "view of conditions": _read_conditions,
}


def feed(data: bytes) -> bool:
    """Put bytes through every decoder and the checks behind it; return whether any takes them.

    Anything but a ProtocolError is the defect that is looked for, and passes through.
    """
    return any([_taken(read, data) for read in READERS.values()])


def _taken(read: Callable[[bytes], None], data: bytes) -> bool:
    try:
        read(data)
    except ProtocolError:
        return False
    return True


def sealed(data: bytes) -> bytes:
    """Return a frame whose lengths and checksum fit its content again, so that what is behind them is reached."""
    if len(data) < _PREFIX.size:
        return data
    magic, protocol, kind, reserved, header, _, _ = _PREFIX.unpack_from(data)
    content = data[_PREFIX.size :]
    header = min(header, len(content))
    prefix = _PREFIX.pack(magic, protocol, kind, reserved, header, len(content) - header, frame.checksum(content))
    return prefix + content


def _flip(data: bytearray, draw: random.Random) -> None:
    data[draw.randrange(len(data))] ^= 1 << draw.randrange(8)


def _set(data: bytearray, draw: random.Random) -> None:
    data[draw.randrange(len(data))] = draw.choice((0x00, 0x7F, 0x80, 0xC0, 0xC1, 0xDC, 0xDD, 0xDF, 0xFF))


def _cut(data: bytearray, draw: random.Random) -> None:
    del data[draw.randrange(len(data)) :]


def _drop(data: bytearray, draw: random.Random) -> None:
    start = draw.randrange(len(data))
    del data[start : start + draw.randrange(1, 9)]


def _repeat(data: bytearray, draw: random.Random) -> None:
    start = draw.randrange(len(data))
    data[start:start] = data[start : start + draw.randrange(1, 33)]


def _grow(data: bytearray, draw: random.Random) -> None:
    data[draw.randrange(len(data)) : 0] = draw.randbytes(draw.randrange(1, 9))


_WAYS: Final[tuple[Callable[[bytearray, random.Random], None], ...]] = (
    _flip,
    _flip,
    _set,
    _set,
    _cut,
    _drop,
    _repeat,
    _grow,
)


def mutant(whole: bytes, draw: random.Random) -> bytes:
    """Return a spoilt frame; half of them have lengths and checksum that fit."""
    data = bytearray(whole)
    for _ in range(draw.randrange(1, 5)):
        if data:
            draw.choice(_WAYS)(data, draw)
    return sealed(bytes(data)) if draw.random() < 0.5 else bytes(data)


def pass_through(count: int, seed: int) -> int:
    """Feed so many mutants to the decoder of their own kind and to its checks; return how many were taken."""
    draw, taken = random.Random(seed), 0
    wholes = list(samples().items())
    for _ in range(count):
        name, whole = draw.choice(wholes)
        taken += _taken(READERS[name], mutant(whole, draw))
    return taken


assert frame.PROTOCOL == 5  # the prefix above is that of protocol 5
