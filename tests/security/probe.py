"""A process with one certificate that tries whatever it is asked to, one line of JSON for each order and each outcome.

`python -m tests.security.probe FOLDER ENDPOINT`; orders: {"do": KIND, "keys": [...]}, {"do": "seen"}, {"do": "drop"}.
It uses Zenoh directly, since it has to do what our own code never does.
"""

import json
import sys
import threading
from pathlib import Path
from typing import Any

import zenoh

from eia_sec.common.transport.endpoint import Endpoint
from eia_sec.common.transport.zenoh_config import connecting


class Probe:
    """One session and what it has declared and seen."""

    def __init__(self, session: zenoh.Session, name: str) -> None:
        self.session, self.name = session, name
        self.held: list[tuple[str, Any]] = []
        self.pending: list[Any] = []

    def do(self, kind: str, key: str) -> None:
        """Do one thing with one key."""
        mark = f"{self.name} {kind} {key}"
        if kind == "put":
            self.session.put(key, mark, attachment=mark)
        elif kind == "delete":
            self.session.delete(key, attachment=mark)
        elif kind == "ask":
            self.pending.append(
                self.session.get(key, zenoh.handlers.FifoChannel(64), payload=mark, attachment=mark, timeout=5.0)
            )
        elif kind == "read":
            self.held.append((key, self.session.declare_subscriber(key, zenoh.handlers.FifoChannel(4096))))
        elif kind == "answer":
            queryable = self.session.declare_queryable(key, zenoh.handlers.FifoChannel(256), complete=True)
            threading.Thread(target=answer, args=(queryable, mark), daemon=True).start()
            self.held.append((key, queryable))
        elif kind == "appear":
            self.held.append((key, self.session.liveliness().declare_token(key)))
        elif kind == "watch":
            channel = zenoh.handlers.FifoChannel(4096)
            self.held.append((key, self.session.liveliness().declare_subscriber(key, channel, history=True)))
            self.pending.append((key, self.session.liveliness().get(key, zenoh.handlers.FifoChannel(64), timeout=5.0)))

    def seen(self) -> list[str]:
        """Return the keys under which something has arrived."""
        found = set()
        for key, entity in self.held:
            handler = getattr(entity, "handler", None)
            if handler is not None and not isinstance(entity, zenoh.Queryable) and handler.try_recv() is not None:
                found.add(key)
        for key, replies in [pair for pair in self.pending if isinstance(pair, tuple)]:
            try:
                reply = replies.try_recv()
            except zenoh.ZError:
                continue
            if reply is not None and reply.ok is not None:
                found.add(key)
        return sorted(found)

    def drop(self) -> None:
        """Take everything back."""
        for _, entity in self.held:
            entity.undeclare()
        self.held.clear()
        self.pending.clear()


def answer(queryable: Any, mark: str) -> None:
    """Answer every request with a mark until the queryable is gone."""
    while True:
        try:
            query = queryable.handler.recv()
        except zenoh.ZError:
            return
        with query:
            query.reply(query.key_expr, mark)


def open_session(values: dict[str, Any]) -> zenoh.Session:
    """Open a session with the configuration that our own processes use."""
    config = zenoh.Config()
    for key, value in values.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def main(folder: str, endpoint: str) -> None:
    """Serve orders until the input ends."""
    with open_session(connecting(Endpoint.parse(endpoint, Path(folder)), "control")) as session:
        probe = Probe(session, Path(folder).name)
        write({"ready": True})
        for line in sys.stdin:
            order = json.loads(line)
            found: list[str] = []
            if order["do"] == "seen":
                found = probe.seen()
            elif order["do"] == "drop":
                probe.drop()
            else:
                for key in order["keys"]:
                    probe.do(order["do"], key)
            write({"found": found})


def write(message: dict[str, Any]) -> None:
    """Write one line."""
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
