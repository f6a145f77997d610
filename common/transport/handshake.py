"""Why a link failed: Zenoh reports "timeout" for every cause, so one TLS handshake of our own finds the real one."""

import contextlib
import socket
import ssl
from typing import TYPE_CHECKING, Final

from eia_sec.common.transport.endpoint import Endpoint, Lane

if TYPE_CHECKING:
    from eia_sec.common.transport.credentials import (
        Credentials,
    )  # loads cryptography, which links without TLS do without

CONNECT_SECONDS: Final = 2.0
ALERT_SECONDS: Final = 0.5
"""Time for the other side to reject our certificate, which in TLS 1.3 it does after the handshake, s."""

_ALERTS: Final = {
    "CERTIFICATE_REQUIRED": "it was given no certificate",
    "CERTIFICATE_EXPIRED": "the certificate has expired by the listener's clock",
    "UNKNOWN_CA": "another authority signed the certificate",
    "BAD_CERTIFICATE": "another authority signed the certificate, or it is damaged",
    "DECRYPT_ERROR": "another authority of the same name signed the certificate",
    "CERTIFICATE_UNKNOWN": "it cannot use the certificate",
    "ACCESS_DENIED": "it denies access",
}
_VERDICTS: Final = {
    9: "its certificate is not valid yet by this machine's clock",
    10: "its certificate has expired",
    18: "another authority signed its certificate",
    19: "another authority signed its certificate",
    20: "another authority signed its certificate",
    26: "its certificate belongs to a process that may only connect",
    62: "its certificate is not for this host name",
    64: "its certificate is not for this address",
}


def complaint(endpoint: Endpoint, lane: Lane) -> str | None:
    """Return one sentence on why a listener and this process reject each other.

    Args:
        endpoint: where a listener may be.
        lane: which of its two ports.

    Returns:
        The sentence, or None when nobody listens there or certificates are not the cause.
    """
    where, credentials = endpoint.locator(lane), endpoint.credentials
    try:
        link = _dial(endpoint, lane)
    except OSError:
        return None
    with contextlib.closing(link):
        if credentials is None:
            return f"{where} speaks TLS; this process needs --tls FOLDER." if _speaks_tls(link) else None
        return _compare(link, where, endpoint.host.strip("[]"), credentials)


def silence(endpoint: Endpoint, lane: Lane) -> str:
    """Return one sentence on a listener that did not answer in time."""
    where = endpoint.locator(lane)
    with contextlib.suppress(OSError), _dial(endpoint, lane):
        causes = (
            "it hangs, has as many as it can, or listens without TLS"
            if endpoint.credentials
            else "it hangs, or has as many as it can"
        )
        return f"{where} accepts connections but opens no session: {causes}."
    return f"nobody answers at {where}."


def _dial(endpoint: Endpoint, lane: Lane) -> socket.socket:
    port = endpoint.port + (lane == "bulk")
    return socket.create_connection((endpoint.host.strip("[]"), port), CONNECT_SECONDS)


def _compare(link: socket.socket, where: str, host: str, credentials: "Credentials") -> str | None:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    try:
        context.load_verify_locations(credentials.ca)
        context.load_cert_chain(credentials.certificate, credentials.key)
        link.settimeout(CONNECT_SECONDS)
        with context.wrap_socket(link, server_hostname=host) as wrapped:
            wrapped.settimeout(ALERT_SECONDS)
            wrapped.recv(1)
    except ssl.SSLCertVerificationError as error:
        verdict = _VERDICTS.get(error.verify_code, error.verify_message)
        return f"the listener at {where} is not accepted: {verdict} (checked against {credentials.ca})."
    except (ssl.SSLEOFError, ssl.SSLZeroReturnError):
        # The listener hung up midway, as one does that is starting or ending; certificates need not be the cause.
        return None
    except ssl.SSLError as error:
        reason = str(error.reason or "")
        alert = next((text for name, text in _ALERTS.items() if reason.endswith(name)), None)
        if alert is not None:
            return f"the listener at {where} did not accept {credentials}: {alert}."
        return f"the TLS handshake with the listener at {where} failed ({reason or error})."
    except OSError:
        # A listener without TLS does not answer a handshake, nor does one that is still starting.
        return None
    return None


def _speaks_tls(link: socket.socket) -> bool:
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    try:
        link.settimeout(CONNECT_SECONDS)
        with context.wrap_socket(link):
            return True
    except ssl.SSLError as error:
        return str(error.reason or "").endswith("CERTIFICATE_REQUIRED")
    except OSError:
        return False
