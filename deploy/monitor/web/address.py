"""Addresses on which a page or figures are served over HTTP."""

from typing import Final

from eia_sec.common.errors import EndpointError
from eia_sec.common.transport.endpoint import Endpoint

LOOPBACK: Final = ("127.0.0.1", "localhost", "[::1]")
"""Names by which requests ask for this machine."""

HTTP: Final = 80
"""The port that browsers leave out of Host and Origin."""


def own_hosts(host: str, port: int) -> set[str]:
    """Return the Host headers of requests that ask for a server of this machine.

    Args:
        host: the address that it listens on.
        port: its port.
    """
    names = {*LOOPBACK, bracketed(host)}
    return {f"{name}:{port}" for name in names} | (names if port == HTTP else set())


def bracketed(host: str) -> str:
    """Return a host as it stands in a URL."""
    return f"[{host}]" if ":" in host and not host.startswith("[") else host


def require_own_address(host: str, *, insecure: bool, what: str) -> None:
    """Refuse an address that other machines reach.

    Args:
        host: the address.
        insecure: whether that is intended.
        what: what anybody there could do, for the message.

    Raises:
        EndpointError: it is such an address, and not intended.
    """
    if not (insecure or Endpoint("tcp", host, 1).is_loopback):
        raise EndpointError(f"anybody who reaches {host} could {what}; add --insecure if that is intended.")
