"""Whoever holds a right to read gets what long-lived senders send, whether it comes before them or after them."""

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import pytest
import zenoh

from eia_sec.common.protocol import access, keys
from eia_sec.common.transport.bus import Bus, Publisher
from eia_sec.common.transport.credentials import Identity
from eia_sec.common.transport.endpoint import Endpoint, free_endpoint
from eia_sec.common.transport.zenoh_config import connecting, listening
from tests.security.probe import open_session

RUN = "late"
NAMES = (
    "learner.learner",
    "rollout.a",
    "elite.coordinator",
    "monitor.m",
    "operator.o",
    "watcher.w",
    "vehicle.uav",
    "flight.main",
    "environment.site",
)
COUNTERPART = {"put": "read", "ask": "answer", "appear": "watch"}
"""What the other side of a right holds."""
SECONDS = 15.0
MOMENT = 0.5
"""Time in which declarations reach everybody."""


@dataclass(frozen=True, order=True)
class Way:
    """A message that the table lets pass: from whom, to whom, on which key, read under which key expression."""

    right: str
    sender: str
    reader: str
    key: str
    wide: str


def concrete_keys() -> set[str]:
    """Return the keys on which the processes of NAMES send."""
    found = set()
    for family, verb, name in product(keys.FAMILIES, keys.VERBS, map(Identity.parse, NAMES)):
        variables = {"worker": "a", "vehicle": "uav", "verb": verb, "role": name.role, "name": name.name}
        found.add(family.key(RUN, environment="site", **variables))
    return found


def ways() -> list[Way]:
    """Return every way that the table opens between two of the processes."""

    def held(name: str) -> list[tuple[str, str]]:
        identity = Identity.parse(name)
        return [pair for grant in access.grants_of(identity.role) for pair in grant.expressions(identity.name, RUN)]

    def covers(wide: str, key: str) -> bool:
        return "@adv" not in wide and zenoh.KeyExpr(wide).includes(zenoh.KeyExpr(key))

    return sorted(
        {
            Way(right, sender, reader, key, wide)
            for sender, reader, key in product(NAMES, NAMES, concrete_keys())
            for right, other in COUNTERPART.items()
            if sender != reader and any(r == right and covers(narrow, key) for r, narrow in held(sender))
            for r, wide in held(reader)
            if r == other and covers(wide, key)
        }
    )


class Party:
    """One process's session: senders that live as long as it, and readers."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._publishers: dict[str, zenoh.Publisher | Publisher] = {}
        self._queriers: dict[str, zenoh.Querier] = {}
        self._tokens: dict[str, Any] = {}
        self._asked: list[tuple[str, Any]] = []
        self._readers: dict[tuple[str, str], Any] = {}

    def prepare(self, way: Way) -> None:
        """Declare the sender of a way, once for each key."""
        if way.right == "put" and way.key not in self._publishers:
            state = keys.parse(way.key).family.delivery == "state"
            declare = Bus(self._session).publish_state if state else self._session.declare_publisher
            self._publishers[way.key] = declare(way.key)
        elif way.right == "ask" and way.key not in self._queriers:
            self._queriers[way.key] = self._session.declare_querier(way.key, timeout=2.0)
        elif way.right == "appear" and way.key not in self._tokens:
            self._tokens[way.key] = self._session.liveliness().declare_token(way.key)

    def open(self, way: Way) -> None:
        """Declare the reader of a way, once for each key expression."""
        if (way.right, way.wide) in self._readers:
            return
        channel = zenoh.handlers.FifoChannel(4096)
        if way.right == "put":
            reader: Any = self._session.declare_subscriber(way.wide, channel)
        elif way.right == "ask":
            reader = self._session.declare_queryable(way.wide, channel, complete=True)
        else:
            reader = self._session.liveliness().declare_subscriber(way.wide, channel, history=True)
        self._readers[way.right, way.wide] = reader

    def send(self) -> None:
        """Put and ask once on every key."""
        for publisher in self._publishers.values():
            publisher.put(b"message")
        self._asked += [(key, querier.get(payload=b"message")) for key, querier in self._queriers.items()]

    def read(self) -> set[tuple[str, str, str]]:
        """Return right, key and key expression of what has arrived since the last call; answer what was asked."""
        found = set()
        for (right, wide), reader in self._readers.items():
            while (came := reader.handler.try_recv()) is not None:
                found.add((right, str(came.key_expr), wide))
                if isinstance(came, zenoh.Query):
                    with came:
                        came.reply(came.key_expr, b"answer")
        return found

    def answered(self) -> set[str]:
        """Return the keys on which a request was answered since the last call."""
        found, waiting = set(), []
        for key, replies in self._asked:
            try:
                reply = replies.try_recv()
            except zenoh.ZError:
                continue
            if reply is None:
                waiting.append((key, replies))
            elif reply.ok is not None:
                found.add(key)
        self._asked = waiting
        return found


@contextmanager
def parties(folder: Path, listener: str) -> Iterator[dict[str, Party]]:
    """Open a session for each name; they meet at one of them, or at a router."""
    endpoint = str(free_endpoint())
    with ExitStack() as stack:
        sessions = {}
        if listener == "router.main":
            where = endpoint.replace("tcp/", "tls/")
            command = ["router", "--listen", where, "--tls", str(folder / listener)]
            router = subprocess.Popen(
                [sys.executable, "-m", "eia_sec.deploy.cli", *command], stderr=subprocess.PIPE, text=True
            )
            stack.callback(router.wait, 10.0)
            stack.callback(router.terminate)
            assert router.stderr is not None
            assert "listening on" in router.stderr.readline()
        else:
            there = Endpoint.parse(endpoint, folder / listener)
            sessions[listener] = stack.enter_context(open_session(listening(there, "control")))
        for name in NAMES:
            if name != listener:
                there = Endpoint.parse(endpoint, folder / name)
                sessions[name] = stack.enter_context(open_session(connecting(there, "control")))
        yield {name: Party(session) for name, session in sessions.items()}


@pytest.mark.parametrize("listener", ["router.main", "learner.learner", "flight.main"])
@pytest.mark.parametrize("late", ["reader", "sender"])
def test_what_a_lasting_sender_sends_reaches_everybody_who_may_read_it(keys_folder, listener, late):
    """With certificates, each put, request and token arrives under the widest expression that its reader holds."""
    expected = ways()
    assert {(way.right, keys.parse(way.key).family.template) for way in expected} >= {
        ("put", keys.METRIC.template),
        ("put", keys.VIEW.template),
        ("put", keys.POSE.template),
        ("ask", keys.TRANSITION.template),
        ("ask", keys.ENVIRONMENT.template),
        ("appear", keys.ENVIRONMENT_LIVE.template),
        ("appear", keys.LIVE.template),
    }
    with parties(keys_folder, listener) as found:
        for turn in ("sender", "reader") if late == "reader" else ("reader", "sender"):
            for way in expected:
                found[way.sender].prepare(way) if turn == "sender" else found[way.reader].open(way)
            time.sleep(MOMENT)
            for party in found.values():
                party.send()
        missing = {(way.right, way.reader, way.key, way.wide) for way in expected}
        unanswered = {(way.sender, way.key) for way in expected if way.right == "ask"}
        deadline = time.monotonic() + SECONDS
        while (missing or unanswered) and time.monotonic() < deadline:
            for name, party in found.items():
                missing -= {(right, name, key, wide) for right, key, wide in party.read()}
                unanswered -= {(name, key) for key in party.answered()}
                party.send()
            time.sleep(0.1)
        assert (sorted(missing), sorted(unanswered)) == ([], [])
