"""The messages between a worker and a served environment: msgpack maps, which any language can write and read.

docs/reference/remote_protocol.md describes them for programs without this package. They have no frame: an environment
on a robot needs zenoh and msgpack, and nothing else. A field that the receiver does not know is ignored. One that is
missing has its default.
"""

from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, Self, get_origin, get_type_hints

import msgpack

from eia_sec.common.errors import SchemaError

MOST_TEXT: Final = 4096
"""Longest text of a message, bytes."""
MOST_ENTRIES: Final = 65_536
"""Most entries of one list or map of a message."""
MOST_COPIES: Final = 4096
"""Most copies that one environment serves."""
DONE, TAKEN, LOST, LATE, GAP, MALFORMED, OUTAGE, FAULT = (
    "done",
    "taken",
    "lost",
    "late",
    "gap",
    "malformed",
    "outage",
    "fault",
)
STATUSES: Final = {
    DONE: "the request was granted and carried out",
    TAKEN: "another worker holds the environment (answer to a claim only)",
    LOST: "the request names an incarnation or a lease that is not the current one; claim again",
    LATE: "the sequence number lies before the newest one that was carried out; nothing was done",
    GAP: "the sequence number skips one; nothing was done",
    MALFORMED: "the request cannot be read, or does not fit the environment; nothing was done",
    OUTAGE: "the simulator or robot behind the environment is away; the lease goes on",
    FAULT: "the environment's own code failed",
}
"""What an answer says, and what it means."""


class PlainMessage:
    """Base of these messages: a msgpack map of the fields."""

    MOST_BYTES: ClassVar[int] = 64 * 1024
    """Longest message of this type; of a step's, the receiver knows a limit from the spaces."""

    def encode(self) -> bytes:
        """Return the message's bytes."""
        return bytes(msgpack.packb({name: getattr(self, name) for name, _ in _plan(type(self))}))

    @classmethod
    def decode(cls, data: bytes, most: int = 0) -> Self:
        """Return the message in some bytes.

        Args:
            data: the bytes.
            most: most bytes, where it is not MOST_BYTES.

        Raises:
            SchemaError: it is too long, no map, or a field has another type.
        """
        if len(data) > (limit := most or cls.MOST_BYTES):
            raise SchemaError(f"{cls.__name__} has {len(data)} bytes, more than {limit}.")
        try:
            found = msgpack.unpackb(
                data, strict_map_key=True, max_array_len=MOST_ENTRIES, max_map_len=MOST_ENTRIES, max_ext_len=0
            )
        except (ValueError, TypeError, msgpack.exceptions.UnpackException, RecursionError) as error:
            raise SchemaError(f"{cls.__name__} cannot be read: {str(error)[:120]}") from error
        if not isinstance(found, dict):
            raise SchemaError(f"{cls.__name__} is no map.")
        return cls(**{name: _read(cls, name, kind, found[name]) for name, kind in _plan(cls) if name in found})


@dataclass(frozen=True)
class ClaimRequest(PlainMessage):
    """A worker's request for the environment; its key ends in `claim`.

    Attributes:
        worker: who asks, for logs and for the refusal of others; run and name, train/0 for instance.
        nonce: a random number that belongs to this claim alone. The same number again is the same claim.
    """

    worker: str = ""
    nonce: int = 0


@dataclass(frozen=True)
class ClaimAnswer(PlainMessage):
    """The answer to a claim; with another status than done, only status and reason count.

    Attributes:
        status: done, taken, lost or malformed.
        reason: a sentence about any other status than done.
        incarnation: number of the environment's process; each start has a greater one.
        lease: number of the lease, greater than all before it in this incarnation.
        lease_seconds: time after the last request with this lease, from which on another claim may be granted, s.
        copies: number of copies of the environment that a step moves together.
        agents: names of all agents that may take part.
        observation_spaces: of each agent in that order, see the table of spaces.
        action_spaces: likewise.
    """

    MOST_BYTES: ClassVar[int] = 64 * 1024 * 1024
    status: str = MALFORMED
    reason: str = ""
    incarnation: int = 0
    lease: int = 0
    lease_seconds: float = 0.0
    copies: int = 1
    agents: list[Any] = field(default_factory=list)
    observation_spaces: list[Any] = field(default_factory=list)
    action_spaces: list[Any] = field(default_factory=list)


@dataclass(frozen=True)
class StepRequest(PlainMessage):
    """A request to move the copies; its key ends in `step`.

    Attributes:
        incarnation, lease: of the claim.
        sequence: 1 for the first request of a lease, and one more for each that follows. A request that is sent again
            keeps its number.
        copies: for each copy what to do: null to stand still, a whole number from 0 on to begin an episode with this
            seed, or a map with the action of each living agent by name.
    """

    incarnation: int = 0
    lease: int = 0
    sequence: int = 0
    copies: list[Any] = field(default_factory=list)


@dataclass(frozen=True)
class StepAnswer(PlainMessage):
    """The answer to a step.

    Attributes:
        status: any but taken.
        reason: a sentence about any other status than done.
        sequence: that of the request.
        copies: for each copy null where it stood still, or else a map with observations, rewards, terminations,
            truncations and infos, each a map by agent, and agents, the names of the living ones. An episode's beginning
            has no rewards, terminations and truncations. With another status than done the list is empty.
    """

    status: str = MALFORMED
    reason: str = ""
    sequence: int = 0
    copies: list[Any] = field(default_factory=list)


@dataclass(frozen=True)
class LeaseRequest(PlainMessage):
    """A sign that a worker still wants its lease, or a farewell; its key ends in `renew` or `release`.

    Attributes:
        incarnation, lease: of the claim.
    """

    incarnation: int = 0
    lease: int = 0


@dataclass(frozen=True)
class LeaseAnswer(PlainMessage):
    """The answer to a renewal or a release.

    Attributes:
        status: done, lost or malformed.
        reason: a sentence about any other status than done.
    """

    status: str = MALFORMED
    reason: str = ""


MESSAGES: Final = (ClaimRequest, StepRequest, LeaseRequest, ClaimAnswer, StepAnswer, LeaseAnswer)


_PLANS: Final[dict[Any, tuple[tuple[str, Any], ...]]] = {}


def _plan(cls: Any) -> tuple[tuple[str, Any], ...]:
    """Return the names and types of a message's fields; cached, as inspecting annotations is slower than reading."""
    if (plan := _PLANS.get(cls)) is not None:
        return plan
    hints = {name: get_origin(hint) or hint for name, hint in get_type_hints(cls).items()}
    plan = _PLANS[cls] = tuple((name, hint) for name, hint in hints.items() if hint is not ClassVar)
    return plan


def _read(cls: type[PlainMessage], name: str, kind: type[Any], value: Any) -> Any:
    """Return a field's value; raise SchemaError unless it has the declared type."""
    if kind is float and type(value) in (int, float):
        return float(value)
    fits = type(value) is kind
    if kind is int:
        fits = fits and 0 <= value < 2**63
    if kind is str:
        fits = fits and len(value) <= MOST_TEXT
    if not fits:
        raise SchemaError(f"field {name} of {cls.__name__} is no {kind.__name__} in its range.")
    return value
