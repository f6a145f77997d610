"""The observed access matrix: real processes, one for each certificate, try every kind of message on every key."""

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import zenoh

from eia_sec.common.protocol import access, keys
from eia_sec.common.transport.credentials import Identity
from eia_sec.common.transport.endpoint import Endpoint, free_endpoint
from eia_sec.common.transport.zenoh_config import listening
from tests.security.probe import open_session

RUN = "matrix"
ROOT = f"{keys.ROOT}/{RUN}"
INGRESS = ("put", "delete", "ask", "appear")
"""What a process sends by itself."""
EGRESS = ("read", "answer", "watch")
"""What reaches a process when somebody else sends, asks or appears."""
WILD = (
    "**",
    f"{ROOT}/**",
    f"{keys.ROOT}/*/*/*",
    f"{ROOT}/transition/*",
    f"{ROOT}/metric/**",
    f"{ROOT}/live/**",
    f"{ROOT}/flight/**",
    f"{ROOT}/flight/*/setpoint",
    f"{keys.ROOT}/*/params/actors/**",
    f"{keys.ENVIRONMENT_ROOT}/**",
    f"{keys.ENVIRONMENT_ROOT}/live/*",
    f"{keys.ENVIRONMENT_ROOT}/request/site/*",
)
SECONDS = 20.0
GRACE = 0.6
"""Time for what must not arrive, after everything has arrived that must."""

Cell = tuple[str, str, str]
"""Process, kind and key."""


def concrete_keys(identity: Identity) -> tuple[str, ...]:
    """Return every key family's keys for one process: its own, and somebody else's."""
    found = []
    for family in keys.FAMILIES:
        names = {identity.name, "b"}
        for name in sorted(names):
            role = identity.role if name == identity.name else "rollout"
            for verb in ("configuration", "drain"):
                own = {"worker": name, "vehicle": name, "environment": name}
                found.append(family.key(RUN, role=role, name=name, verb=verb, **own))
        if family.delivery == "state":
            found.append(f"{ROOT}/{family.template}/@adv/pub/x/1/_")
    return (*dict.fromkeys(found), f"{ROOT}/live/learner/learner", f"{ROOT}/unknown", "elsewhere/key")


def declared(identity: Identity, listed: bool = True) -> set[Cell]:
    """Return what the table in `eia_sec.common.protocol.access` grants to one process, wildcards included."""
    grants = [g for g in access.GRANTS if g.role == access.ANYBODY or (listed and g.role == identity.role)]
    pairs = [pair for grant in grants for pair in grant.expressions(identity.name)]
    return {
        (str(identity), kind, key)
        for kind in (*INGRESS, *EGRESS)
        for key in (*concrete_keys(identity), *WILD)
        if any(right == kind and zenoh.KeyExpr(wide).includes(zenoh.KeyExpr(key)) for right, wide in pairs)
    }


class Prober:
    """A probe in a process of its own."""

    def __init__(self, folder: Path, endpoint: Endpoint) -> None:
        self.identity = Identity.parse(folder.name)
        self._process = subprocess.Popen(
            [sys.executable, "-m", "tests.security.probe", str(folder), str(endpoint)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def send(self, kind: str, chosen: tuple[str, ...] = ()) -> None:
        """Give an order."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps({"do": kind, "keys": chosen}) + "\n")
        self._process.stdin.flush()

    def hear(self) -> dict[str, Any]:
        """Return the outcome."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line, f"the probe of {self.identity} ended"
        return json.loads(line)

    def close(self) -> None:
        """End the process."""
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.wait(SECONDS)


class Witness:
    """The listening session: it sees whatever passes the access list."""

    def __init__(self, session: zenoh.Session) -> None:
        self.session = session
        channel = zenoh.handlers.FifoChannel
        self._subscriber = session.declare_subscriber("**", channel(65_536))
        self._hidden = session.declare_subscriber(f"{keys.ROOT}/**/@adv/**", channel(65_536))
        self._tokens = session.liveliness().declare_subscriber("**", channel(65_536), history=True)
        self._hidden_tokens = session.liveliness().declare_subscriber(f"{keys.ROOT}/**/@adv/**", channel(65_536))
        self._queryables = [
            session.declare_queryable(key, channel(65_536), complete=True) for key in ("**", f"{keys.ROOT}/**/@adv/**")
        ]

    def serve(self, wanted: set[str]) -> list[Any]:
        """Declare a queryable on each key, so that an asker knows of somebody to ask."""
        channel = zenoh.handlers.FifoChannel
        return [self.session.declare_queryable(key, channel(4096), complete=True) for key in sorted(wanted)]

    def marks(self, extra: list[Any]) -> set[str]:
        """Return the marks of puts, deletes and requests that have arrived."""
        found = set()
        for subscriber in (self._subscriber, self._hidden):
            while (sample := subscriber.handler.try_recv()) is not None:
                if sample.attachment is not None:
                    found.add(sample.attachment.to_string())
        for queryable in (*self._queryables, *extra):
            while (query := queryable.handler.try_recv()) is not None:
                with query:
                    if query.attachment is not None:
                        found.add(query.attachment.to_string())
        return found

    def tokens(self) -> set[str]:
        """Return the keys of tokens that have appeared."""
        found = set()
        for subscriber in (self._tokens, self._hidden_tokens):
            while (sample := subscriber.handler.try_recv()) is not None:
                if sample.kind == zenoh.SampleKind.PUT:
                    found.add(str(sample.key_expr))
        return found

    def settle(self) -> None:
        """Forget what has arrived so far."""
        time.sleep(GRACE / 2)
        self.marks([])
        self.tokens()


@contextmanager
def stage(
    folder: Path, names: tuple[str, ...], alter: Callable[[dict[str, Any]], dict[str, Any]] = lambda acl: acl
) -> Iterator[tuple[Witness, list[Prober]]]:
    """Open a listener with the learner's certificate, and one probe for each name.

    Args:
        folder: the authority.
        names: whose certificates the probes get.
        alter: changes the access list; for the mutations.
    """
    endpoint = Endpoint.parse(str(free_endpoint()), folder / "learner.learner")
    values = listening(endpoint, "control")
    values["access_control"] = alter(values["access_control"])
    with open_session(values) as session:
        probes = [Prober(folder / name, replace(endpoint, credentials=None)) for name in names]
        try:
            for probe in probes:
                probe.hear()
            yield Witness(session), probes
        finally:
            for probe in probes:
                probe.close()


def everybody(probes: list[Prober], kind: str, chosen: Callable[[Prober], tuple[str, ...]]) -> list[list[str]]:
    """Give all probes one order and return their outcomes."""
    for probe in probes:
        probe.send(kind, chosen(probe))
    return [probe.hear()["found"] for probe in probes]


def gather(look: Callable[[], set[Cell]], wanted: set[Cell]) -> set[Cell]:
    """Look until everything has been seen that must be, and a little longer for what must not."""
    found: set[Cell] = set()
    deadline = time.monotonic() + SECONDS
    while not wanted <= found and time.monotonic() < deadline:
        found |= look()
        time.sleep(0.05)
    end = time.monotonic() + GRACE
    while time.monotonic() < end:
        found |= look()
        time.sleep(0.1)
    return found


def observe_ingress(witness: Witness, probes: list[Prober], wanted: set[Cell]) -> set[Cell]:
    """Return what reached the listener of everything that the probes put, deleted, asked and declared as tokens."""
    found: set[Cell] = set()
    held = witness.serve({key for p in probes for key in (*concrete_keys(p.identity), *WILD)})
    time.sleep(GRACE)
    for kind in ("put", "delete", "ask"):
        witness.settle()
        everybody(probes, kind, lambda p: (*concrete_keys(p.identity), *WILD))

        def arrived() -> set[Cell]:
            marks = (mark.split(" ") for mark in witness.marks(held))
            return {(who, what, key) for who, what, key in marks}

        found |= gather(arrived, {cell for cell in wanted if cell[1] == kind})
    for queryable in held:
        queryable.undeclare()
    for probe in probes:
        # A token has no payload that could say whose it is: one probe at a time.
        mine = {cell for cell in wanted if cell[:2] == (str(probe.identity), "appear")}
        witness.settle()
        everybody([probe], "appear", lambda p: (*concrete_keys(p.identity), *WILD))
        who = str(probe.identity)
        found |= gather(lambda who=who: {(who, "appear", key) for key in witness.tokens()}, mine)
        everybody([probe], "drop", lambda p: ())
    return found


def observe_egress(witness: Witness, probes: list[Prober], wanted: set[Cell]) -> set[Cell]:
    """Return what reached the probes of everything that the listener put, asked and declared as tokens.

    Wildcards that are granted to nobody come first, and together; then the others, each alone; concrete keys last. An
    expression that is denied would otherwise be fed, inside the process itself, by one that is granted.
    """
    keys_of = {str(p.identity): concrete_keys(p.identity) for p in probes}
    every = sorted({key for chosen in keys_of.values() for key in chosen})
    tokens = [witness.session.liveliness().declare_token(key) for key in every]
    found: set[Cell] = set()
    for kind in EGRESS:
        granted = tuple(key for key in WILD if any(cell[1:] == (kind, key) for cell in wanted))
        groups = (tuple(key for key in WILD if key not in granted), *((key,) for key in granted), ())
        for group in groups:

            def chosen(probe: Prober, group: tuple[str, ...] = group) -> tuple[str, ...]:
                return group or keys_of[str(probe.identity)]

            here = {(str(p.identity), kind, key) for p in probes for key in chosen(p)} & wanted
            everybody(probes, kind, chosen)
            look = _answers if kind == "answer" else _seen
            found |= gather(lambda look=look, kind=kind: look(witness, probes, kind, every), here)
            everybody(probes, "drop", chosen)
            time.sleep(GRACE / 2)  # what is under way must not reach the next group
    for token in tokens:
        token.undeclare()
    return found


def _seen(witness: Witness, probes: list[Prober], kind: str, every: list[str]) -> set[Cell]:
    if kind == "read":
        for key in every:
            witness.session.put(key, "from the listener")
    outcomes = everybody(probes, "seen", lambda p: ())
    return {(str(p.identity), kind, key) for p, found in zip(probes, outcomes, strict=True) for key in found}


def _answers(witness: Witness, probes: list[Prober], kind: str, every: list[str]) -> set[Cell]:
    found: set[Cell] = set()
    asked = [
        witness.session.get(
            key,
            zenoh.handlers.FifoChannel(256),
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            timeout=0.3,
        )
        for key in every
    ]
    for replies in asked:
        for reply in replies:
            if reply.ok is not None:
                who, what, key = reply.ok.payload.to_string().split(" ")
                found.add((who, what, key))
    return found


def compare(
    folder: Path,
    names: tuple[str, ...],
    observers: tuple[Callable[[Witness, list[Prober], set[Cell]], set[Cell]], ...],
    alter: Callable[[dict[str, Any]], dict[str, Any]] = lambda acl: acl,
) -> tuple[set[Cell], set[Cell]]:
    """Return (what was observed and is not declared, what is declared and was not observed)."""
    members = {name for name in names if name in (folder / "members.txt").read_text().split()}
    wanted = {cell for name in names for cell in declared(Identity.parse(name), name in members)}
    kinds = {kind for o in observers for kind in (INGRESS if o is observe_ingress else EGRESS)}
    wanted = {cell for cell in wanted if cell[1] in kinds}
    found: set[Cell] = set()
    with stage(folder, names, alter) as (witness, probes):
        for observe in observers:
            found |= observe(witness, probes, wanted)
    return found - wanted, wanted - found
