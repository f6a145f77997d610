"""Zenoh's configuration of a session, as plain data; `eia_sec.common.transport.bus` passes it to Zenoh.

`listening` is for a process that others connect to, `routing` for a router, `connecting` for everything else. Discovery
by multicast and gossip is always off.
"""

import json
from typing import TYPE_CHECKING, Any, Final, Literal

from eia_sec.common.protocol.access import access_control, px4_access
from eia_sec.common.protocol.frame import MAX_FRAME
from eia_sec.common.transport.endpoint import Endpoint, Lane

if TYPE_CHECKING:
    from eia_sec.common.transport.credentials import (
        Credentials,
    )  # loads cryptography, which links without TLS do without

LEASE_MS: Final = 4000
"""A peer that is silent for this long counts as gone."""
CONNECT_MS: Final = 1000
"""Time limit of one attempt to connect."""
RETRY: Final = {"period_init_ms": 100, "period_max_ms": 4000, "period_increase_factor": 1.2}
"""Pauses between two tries to connect without TLS, within an attempt and after a connection is lost.

Zenoh's own first pause takes a whole attempt, so that a process joined up to 1.2 s after the learner listened. With TLS
Zenoh's own stay: each try with a certificate that is refused keeps newcomers out for 100 ms.
"""
ACCEPT_MS: Final = 4000
"""Time that a connection has to become a session, after its TLS handshake."""
ACCEPT_PENDING: Final = 1000
"""Most connections that may be in that phase at once; Zenoh hangs up on further ones."""
MAX_SESSIONS: Final = 16_384
"""Most sessions of a listener, two for each worker; Zenoh's own 1,000 end at the 500th. Descriptors may end before."""
HANDSHAKE_MS: Final = 60_000
"""Time that a connection has for its TLS handshake.

Zenoh spends 100 ms on each handshake that fails and admits nobody meanwhile. With a longer limit, fewer silent
connections fail per second.
"""

Values = dict[str, Any]
"""Zenoh's configuration keys, and a JSON value for each."""


def listening(endpoint: Endpoint, lane: Lane, mode: Literal["peer", "router"] = "peer") -> Values:
    """Return the configuration of a session that others connect to.

    With credentials, it accepts only TLS links, requires a certificate of the same authority, and lets each holder do
    what `eia_sec.common.protocol.access` grants.
    """
    values = _base(mode, endpoint, lane) | {
        "listen/endpoints": [_door(endpoint, lane)],
        "listen/exit_on_failure": True,
        "transport/unicast/accept_timeout": ACCEPT_MS,
        "transport/unicast/accept_pending": ACCEPT_PENDING,
        "transport/unicast/max_sessions": MAX_SESSIONS,
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


def admitting_px4(endpoint: Endpoint) -> Values:
    """Return the configuration of a session to which one vehicle's PX4 connects, and nobody beside it."""
    return listening(endpoint, "control") | {"access_control": px4_access(), "transport/unicast/max_sessions": 1}


def routing(endpoint: Endpoint) -> Values:
    """Return the configuration of a router, which serves both lanes on separate links."""
    values = listening(endpoint, "bulk", "router")
    return values | {"listen/endpoints": [_door(endpoint, "control"), _door(endpoint, "bulk")]}


def relaying(endpoint: Endpoint, lane: Lane, upper: Endpoint) -> Values:
    """Return the configuration of a router for one lane, which passes everything on to the router at `upper`.

    A lane has a link of its own there, too, so that transitions do not hold up parameters. It comes back by itself.
    """
    door, way = listening(endpoint, lane, "router"), _dialling(upper, lane)
    values = door | way | {"connect/timeout_ms": -1, "connect/exit_on_failure": False}
    if endpoint.credentials is not None:
        values["transport/link/tls"] = door["transport/link/tls"] | way["transport/link/tls"]
        values["access_control"] = access_control(endpoint.credentials.members, site=True)
    return values


def _door(endpoint: Endpoint, lane: Lane) -> str:
    """Return the locator where a lane listens, with the listener's time limit."""
    bounds = "" if endpoint.credentials is None else f"#tls_handshake_timeout_ms={HANDSHAKE_MS}"
    return endpoint.locator(lane) + bounds


def document(values: Values) -> str:
    """Return a configuration as a JSON5 document, for Zenoh's own programs."""
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
    return _base("client", endpoint, lane) | _dialling(endpoint, lane)


def _dialling(endpoint: Endpoint, lane: Lane) -> Values:
    values: Values = {
        "connect/endpoints": [endpoint.locator(lane)],
        "connect/timeout_ms": CONNECT_MS,
        "connect/exit_on_failure": True,
    }
    credentials = endpoint.credentials
    if credentials is None:
        values["connect/retry"] = RETRY
    else:
        values["transport/link/tls"] = {
            **_tls(credentials),
            "connect_certificate": str(credentials.certificate),
            "connect_private_key": str(credentials.key),
        }
        values["transport/link/protocols"] = ["tls"]
    return values


def _tls(credentials: "Credentials") -> Values:
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
        # Shared memory can drop messages silently when a receiver stalls; the bulk lane acknowledges and resends.
        "transport/shared_memory/enabled": endpoint.shared_memory and lane == "bulk",
    }
