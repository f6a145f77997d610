"""Hostile requests made from the messages' declarations, and a worker of its own that sends them.

    python -m tests.faults.tools.hostile ENDPOINT CONFIG SECONDS

Each kind spoils one field of one message of an otherwise honest request: at its bounds and beyond them, of another type
or shape, left out, with another field's value. It prints how many kinds and requests it sent, and how many were
answered.
"""

import json
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

import numpy as np

from eia_sec.common.config import RunConfig
from eia_sec.common.errors import BusError
from eia_sec.common.protocol import frame, keys
from eia_sec.common.protocol.chunk_messages import to_message
from eia_sec.common.protocol.chunk_rules import ChunkRules
from eia_sec.common.protocol.codec import Message
from eia_sec.common.protocol.messages import ChunkMessage, DeliveryMessage, Envelope
from eia_sec.common.team import TeamSpec
from eia_sec.common.transitions import TRANSITION, TRUNCATED, Chunk, EpisodeSummary, Rows
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import Endpoint
from eia_sec.rollout.envs.registry import environment_spec
from tests.system.fleet import RUN, configured

PER_NAME: Final = 15
"""Requests that one name sends in a row; the receiver would cut it off after a few more."""
NAMES: Final = 8
"""Names of the attacker, each with a certificate of its own where there are any."""
NUMBERS: Final = (0, 2, 2**31, 2**32, 2**48, 2**48 + 1, 2**53, 2**62, 2**63 - 1, 2**63, 2**64 - 1, -1, -(2**63))
OTHERS: Final[tuple[Any, ...]] = (
    None, True, 0, 1.5, float("nan"), float("inf"), -0.0, "", "x", "\0", "../../x", "*", "\x1b[2J", "é" * 300, b"",
    b"x", [], [1], ["x"], [[1]], [None], {}, {"x": 1}, "x" * 40_000, list(range(5_000)),
)  # fmt: skip
"""Values of all types that a header can hold."""
LISTS: Final[tuple[Any, ...]] = ([0], [-1], [2**63 - 1], [2**64 - 1], [1] * 65, [1, 2**62], [1.5], [True])
FAR: Final = (np.nan, np.inf, -np.inf, 1e7, 1.01e7, -1.01e7, 3.4e38, -1.0, 1.0, 1.01)
DTYPES: Final = ("<f4", "<f8", "|u1", "<u2", "<i4", "<i8")
Parts = tuple[dict[str, Any], dict[str, np.ndarray]]


@dataclass(frozen=True)
class Kind:
    """One hostile request.

    Attributes:
        label: message, field, and what is wrong with it.
        spoilt: which message is spoilt.
        parts: that message's scalars and arrays.
    """

    label: str
    spoilt: type[Message]
    parts: Parts


def an_honest_chunk(team: TeamSpec, rules: ChunkRules, *, ended: bool) -> Chunk:
    """Return a chunk of zeros; an environment's first episode may end with it."""
    flags = ([TRANSITION] * rules.chunk_steps + [0]) * rules.environments
    episodes: tuple[EpisodeSummary, ...] = ()
    if ended:
        flags[rules.chunk_steps - 1] |= TRUNCATED
        metrics = dict.fromkeys(rules.episode_metrics, 1.0)
        episodes = (EpisodeSummary(0, 0, max(rules.shortest, rules.chunk_steps), (0.0,) * team.agents, metrics),)
    sizes = (team.observation_size, team.action_size, team.agents)
    return Chunk(
        Rows(*(np.zeros((len(flags), size), np.float32) for size in sizes), np.array(flags, np.uint8)), episodes
    )


def kinds(team: TeamSpec, rules: ChunkRules) -> list[Kind]:
    """Return every kind for a run."""
    chunk = to_message(an_honest_chunk(team, rules, ended=True), team, 0, rules.steps)
    honest = (chunk, DeliveryMessage(1, rules.steps, (1,)), Envelope("rollout", "w", 1, 1))
    return [kind for message in honest for kind in _kinds_of(message)]


def _kinds_of(message: Message) -> Iterator[Kind]:
    name, whole = type(message).__name__, _parts(message)
    for item in fields(message):  # type: ignore[arg-type]  # every message is a dataclass
        spoilt = _arrays(whole[1][item.name]) if item.name in whole[1] else _scalars(whole[0][item.name])
        for what, value in spoilt:
            yield Kind(f"{name}.{item.name} {what}", type(message), _with(whole, item.name, value))
        for other in fields(message):  # type: ignore[arg-type]  # every message is a dataclass
            if other.name != item.name:
                value = whole[1].get(other.name, whole[0].get(other.name))
                yield Kind(f"{name}.{item.name} is {other.name}", type(message), _with(whole, item.name, value))
        yield Kind(f"{name}.{item.name} left out", type(message), _with(whole, item.name, None, drop=True))
        yield Kind(
            f"{name}.{item.name} twice", type(message), _with(whole, f"{item.name}.0", whole[1].get(item.name, 1))
        )


def _scalars(honest: Any) -> Iterator[tuple[str, Any]]:
    values = [*NUMBERS, *OTHERS, *(LISTS if isinstance(honest, list | tuple) else ())]
    return ((f"= {value!r:.30}", value) for value in values)


def _arrays(honest: np.ndarray) -> Iterator[tuple[str, Any]]:
    for dtype in DTYPES:
        yield f"as {dtype}", honest.astype(dtype)
    for far in FAR:
        for place in (0, -1) if honest.size else ():
            spoilt = honest.astype(honest.dtype, copy=True)
            with np.errstate(invalid="ignore", over="ignore"):
                spoilt.reshape(-1)[place] = np.array(far).astype(honest.dtype)
            yield f"{far} at {place}", spoilt
    if honest.dtype.kind in "iu":
        limits = np.iinfo(honest.dtype)
        for value in (limits.min, limits.max, limits.max - 1, 2, 3, 4, 7, 8):
            yield f"all {value}", np.full_like(honest, value)
    yield "one row more", np.concatenate([honest, honest[:1]])
    yield "one row less", honest[:-1]
    yield "no rows", honest[:0]
    yield "one dimension more", honest[None]
    yield "flat", honest.reshape(-1)
    yield "a single number", np.array(honest.reshape(-1)[0] if honest.size else 1.0)
    yield "a thousand times", np.repeat(honest, 1000, axis=0)[:200_000]
    yield "as a scalar", 1
    yield "as a list", [1.0]


def _parts(message: Message) -> Parts:
    values = {item.name: getattr(message, item.name) for item in fields(message)}  # type: ignore[arg-type]  # every message is a dataclass
    arrays = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
    return {name: value for name, value in values.items() if name not in arrays}, arrays


def _with(whole: Parts, name: str, value: Any, *, drop: bool = False) -> Parts:
    scalars = {key: part for key, part in whole[0].items() if key != name}
    arrays = {key: part for key, part in whole[1].items() if key != name}
    if not drop:
        (arrays if isinstance(value, np.ndarray) else scalars)[name] = value
    return scalars, arrays


def request(kind: Kind | None, team: TeamSpec, rules: ChunkRules, name: str, start: int) -> tuple[bytes, bytes]:
    """Return a request's payload and attachment: honest, but for what the kind spoils if there is one."""
    chunk = to_message(an_honest_chunk(team, rules, ended=False), team, 0, rules.steps).encode()
    envelope = Envelope("rollout", name, start, 1).encode()
    if kind is not None and kind.spoilt is ChunkMessage:
        chunk = frame.encode(ChunkMessage.KIND, *kind.parts)
    delivery = DeliveryMessage(1, rules.steps, (len(chunk),)).encode()
    if kind is not None and kind.spoilt is DeliveryMessage:
        scalars = kind.parts[0] | ({"sizes": (len(chunk),)} if kind.parts[0].get("sizes") == (1,) else {})
        delivery = frame.encode(DeliveryMessage.KIND, scalars, kind.parts[1])
    if kind is not None and kind.spoilt is Envelope:
        scalars = {"name": name, "incarnation": start}
        honest = {key: scalars.get(key, value) for key, value in kind.parts[0].items() if value in ("w", 1)}
        envelope = frame.encode(Envelope.KIND, kind.parts[0] | honest, kind.parts[1])
    return delivery + chunk, envelope


class Attacker:
    """A worker of a few names that clears itself with an honest chunk before it would be blocked."""

    def __init__(self, bus: Bus, team: TeamSpec, rules: ChunkRules) -> None:
        self._bus, self._team, self._rules = bus, team, rules
        self.sent = self.answered = 0

    def send(self, kind: Kind | None) -> None:
        """Send a hostile request, or an honest one, each as a new start of its name."""
        name, start = f"h{self.sent // PER_NAME % NAMES}", 1 + self.sent
        payload, attachment = request(kind, self._team, self._rules, name, start)
        self.sent += 1
        try:
            answer = self._bus.ask(keys.TRANSITION.key(RUN, worker=name), payload, 30.0, attachment)
            self.answered += answer is not None
        except BusError:
            self.answered += 1


def main() -> None:
    """Send all kinds, again and again, until the time is over; every kind is sent once at least."""
    config: RunConfig = configured(Path(sys.argv[2]).read_text(encoding="utf-8"))
    environment, until = environment_spec(config), time.monotonic() + float(sys.argv[3])
    team, rules = environment.team, ChunkRules.of(config, environment)
    every, passes = kinds(team, rules), 0
    with Bus.connect(Endpoint.parse(sys.argv[1]), "bulk", wait=30.0) as bus:
        attacker = Attacker(bus, team, rules)
        while passes == 0 or time.monotonic() < until:
            for kind in every:
                if attacker.sent % PER_NAME == 0:
                    attacker.send(None)
                attacker.send(kind)
            passes += 1
            if passes == 1:
                sys.stdout.write("every kind has been sent\n")
                sys.stdout.flush()
    counts = {"kinds": len(every), "requests": attacker.sent, "answered": attacker.answered}
    sys.stdout.write(json.dumps(counts) + "\n")


if __name__ == "__main__":
    main()
