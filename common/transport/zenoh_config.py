"""Zenoh's configuration of a session, as plain data; `common.transport.bus` hands it over.

`listening` is for a learner that others connect to, `routing` for a router, `connecting` for everything else. None of
them finds or is found by anybody: no multicast, no gossip.
"""

import json
from typing import Any, Final, Literal

from common.protocol.access import access_control
from common.protocol.frame import MAX_FRAME
from common.transport.credentials import Credentials
from common.transport.endpoint import Endpoint, Lane

LEASE_MS: Final = 4000
"""A frozen peer counts as gone after this time."""
CONNECT_MS: Final = 1000
"""Longest try to connect."""
ACCEPT_MS: Final = 4000
"""Time that a connection has to become a session once it is there, and its TLS handshake is done."""
ACCEPT_PENDING: Final = 1000
"""Connections that may be on that way at once; beyond them new ones are hung up on."""
HANDSHAKE_MS: Final = 60_000
"""Time that a connection has for its TLS handshake.

Zenoh takes 100 ms for each handshake that fails and lets nobody in meanwhile. The longer silent connections may hang,
the fewer of them fail in a second.
"""

Values = dict[str, Any]
"""Zenoh's configuration keys, and a JSON value for each."""


def listening(endpoint: Endpoint, lane: Lane, mode: Literal["peer", "router"] = "peer") -> Values:
    """Return the configuration of a session that others connect to.

    With credentials, it takes TLS links alone, asks for a certificate of the same authority, and lets each holder do
    what `common.protocol.access` grants to it.
    """
    values = _base(mode, endpoint, lane) | {
        "listen/endpoints": [_door(endpoint, lane)],
        "listen/exit_on_failure": True,
        "transport/unicast/accept_timeout": ACCEPT_MS,
        "transport/unicast/accept_pending": ACCEPT_PENDING,
    }
    credentials = endpoint.credentials
    if credentials is not None:
        values["transport/link/tls"] = {
            **_tls(credentials),
            "listen_certificate": str(credentials.certificate),
            "listen_private_key": str(credentials.key),
        }
        values["transport/link/protocols"] = ["tls"]
        values["access_control"] = access_control(credentials.members)
    return values


def routing(endpoint: Endpoint) -> Values:
    """Return the configuration of a router, which takes both lanes; links of the two never mix."""
    values = listening(endpoint, "bulk", "router")
    return values | {"listen/endpoints": [_door(endpoint, "control"), _door(endpoint, "bulk")]}


def _door(endpoint: Endpoint, lane: Lane) -> str:
    """Return where a lane listens, with the bounds of that listener."""
    bounds = "" if endpoint.credentials is None else f"#tls_handshake_timeout_ms={HANDSHAKE_MS}"
    return endpoint.locator(lane) + bounds


def document(values: Values) -> str:
    """Return a configuration as the text of a file, JSON5, for Zenoh's own programs."""
    nested: Values = {}
    for path, value in values.items():
        *folders, name = path.split("/")
        table = nested
        for folder in folders:
            table = table.setdefault(folder, {})
        table[name] = value
    return json.dumps(nested, indent=2) + "\n"


def connecting(endpoint: Endpoint, lane: Lane) -> Values:
    """Return the configuration of a session that connects to a listener or a router."""
    values = _base("client", endpoint, lane) | {
        "connect/endpoints": [endpoint.locator(lane)],
        "connect/timeout_ms": CONNECT_MS,
        "connect/exit_on_failure": True,
    }
    credentials = endpoint.credentials
    if credentials is not None:
        values["transport/link/tls"] = {
            **_tls(credentials),
            "connect_certificate": str(credentials.certificate),
            "connect_private_key": str(credentials.key),
        }
        values["transport/link/protocols"] = ["tls"]
    return values


def _tls(credentials: Credentials) -> Values:
    return {
        "root_ca_certificate": str(credentials.ca),
        "enable_mtls": True,
        "verify_name_on_connect": True,
        "close_link_on_expiration": True,
    }


def _base(mode: str, endpoint: Endpoint, lane: Lane) -> Values:
    return {
        "mode": mode,
        "listen/endpoints": [],
        "connect/endpoints": [],
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/link/tx/lease": LEASE_MS,
        "transport/link/rx/max_message_size": MAX_FRAME,
        # What is lost in silence when a receiver stalls comes again on the bulk lane, where everything is acknowledged.
        "transport/shared_memory/enabled": endpoint.shared_memory and lane == "bulk",
    }
