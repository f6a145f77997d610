"""Where processes meet: one address, two ports.

The control lane uses the given port, and the bulk lane, which carries transitions, uses the next one. A stalled bulk
consumer delays even urgent messages on the same link, so the lanes never share a link.
"""

import ipaddress
import re
import secrets
import socket
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, Literal

from eia_sec.common.errors import EndpointError

if TYPE_CHECKING:
    from eia_sec.common.transport.credentials import (
        Credentials,
    )  # loads cryptography, which links without TLS do without

Lane = Literal["control", "bulk"]
DEFAULT: Final = "tcp/127.0.0.1:7447"

OWN_PORTS: Final = range(20_000, 32_000)
"""Ports among which `free_endpoint` searches."""

CONSENT: Final = "add --insecure to allow it"
"""Advice of commands that have this option."""

_FORM: Final = re.compile(r"(tcp|tls)/(\[[0-9a-fA-F:]+\]|[A-Za-z0-9.\-]+):(\d{1,5})")


@dataclass(frozen=True)
class Endpoint:
    """A parsed endpoint.

    Attributes:
        protocol: tcp or tls.
        host: name or address; IPv6 in brackets.
        port: port of the control lane; the bulk lane uses the next one.
        credentials: this process's certificate, when the protocol is tls.
        shared_memory: whether the bulk lane may use shared memory; it does when both ends run on one machine and both
            allow it.
    """

    protocol: str
    host: str
    port: int
    credentials: "Credentials | None" = None
    shared_memory: bool = False

    @classmethod
    def parse(cls, text: str, tls: Path | None = None, *, shared_memory: bool = False) -> "Endpoint":
        """Parse "tcp/HOST:PORT".

        Args:
            text: the endpoint.
            tls: folder of this process's certificate; if given, the protocol is tls whatever the text says.
            shared_memory: see the attribute.

        Raises:
            EndpointError: when the text is not an endpoint, or asks for TLS without a certificate.
            CredentialsError: when the certificate cannot be used.
        """
        match = _FORM.fullmatch(text)
        if match is None or not 1 <= int(match[3]) <= 65_534 or not _is_host(match[2]):
            raise EndpointError(f"{text!r} is not an endpoint; write tcp/HOST:PORT with a port of 1 to 65534.")
        endpoint = cls(match[1], match[2], int(match[3]), shared_memory=shared_memory)
        if tls is not None:
            from eia_sec.common.transport.credentials import load  # noqa: PLC0415  (loads cryptography)

            return replace(endpoint, protocol="tls", credentials=load(tls))
        if endpoint.protocol == "tls":
            raise EndpointError(f"{text} needs a certificate: pass --tls FOLDER, made by `eia-sec keys issue`.")
        return endpoint

    def locator(self, lane: Lane) -> str:
        """Return the Zenoh locator of a lane."""
        return f"{self.protocol}/{self.host}:{self.port + (lane == 'bulk')}"

    @property
    def is_loopback(self) -> bool:
        """Whether only this machine can reach it."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host.strip("[]")).is_loopback
        except ValueError:
            return False

    def require_private(self, insecure: bool, advice: str = CONSENT) -> None:
        """Refuse to listen where strangers would be admitted without authentication.

        Args:
            insecure: whether the user allows it.
            advice: what else than a certificate the error recommends.

        Raises:
            EndpointError: other machines reach the address, there is no certificate, and the user does not allow it.
        """
        if not (self.is_loopback or insecure or self.credentials is not None):
            raise EndpointError(
                f"listening on {self} would let anybody who can reach it join, read and steer the run; give a "
                f"certificate with --tls FOLDER (see docs/reference/security.md), or {advice}."
            )

    def __str__(self) -> str:
        return self.locator("control")


def _is_host(host: str) -> bool:
    """Return whether a host name has labels of 1 to 63 letters; addresses in brackets are not checked here."""
    return host.startswith("[") or all(0 < len(label) < 64 for label in host.removesuffix(".").split("."))


def free_endpoint() -> Endpoint:
    """Return a loopback endpoint whose two ports are free now; raise EndpointError when there is none.

    The ports lie below the range from which systems assign outgoing ports, so no connection takes them before a process
    listens there.
    """
    for _ in range(256):
        port = OWN_PORTS.start + 2 * secrets.randbelow(len(OWN_PORTS) // 2)
        try:
            for one in (port, port + 1):
                with socket.socket() as probe:
                    probe.bind(("127.0.0.1", one))
        except OSError:
            continue
        return Endpoint("tcp", "127.0.0.1", port)
    raise EndpointError("no two neighbouring loopback ports are free.")
