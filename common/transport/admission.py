"""How crowded a listener is: open descriptors, and connections that hang in its line.

Zenoh 1.x takes 100 ms for each TLS handshake that fails, one after another, and admits nobody meanwhile. Connections
whose other end has hung up wait in that line and keep a descriptor each. Linux shows both under /proc.
"""

import os
import resource
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from common.transport.endpoint import Endpoint

MOST_WAITING: Final = 20
"""Connections in the line that are no reason for an alarm: two seconds of it."""
FAILURE_SECONDS: Final = 0.1
"""What one failed handshake holds up the line for."""
CROWDED: Final = 0.5
"""Share of the descriptors that a process may have, from which on it is an alarm."""
_TABLES: Final = (Path("/proc/self/net/tcp"), Path("/proc/self/net/tcp6"))
_CLOSE_WAIT: Final = "08"
_MOST_LINES: Final = 65_536


@dataclass(frozen=True)
class Admission:
    """A listener's crowd at one moment.

    Attributes:
        descriptors: open descriptors of this process.
        limit: most that it may have.
        waiting: connections at its ports whose other end has hung up, and which it has not closed yet.
    """

    descriptors: int
    limit: int
    waiting: int

    def metrics(self) -> dict[str, Any]:
        """Return what a report says of it."""
        return {"descriptors": self.descriptors, "waiting_connections": self.waiting}

    def alarms(self) -> list[str]:
        """Return one sentence for each thing that keeps new members out."""
        found = []
        if self.waiting > MOST_WAITING:
            found.append(
                f"{self.waiting} connections hung up before they were let in; a new member waits about "
                f"{self.waiting * FAILURE_SECONDS:.0f} s behind them. Limit new connections by address in the firewall."
            )
        if self.descriptors > CROWDED * self.limit:
            found.append(f"{self.descriptors} of {self.limit} descriptors are open; without any left nobody gets in.")
        return found


def admission(endpoint: Endpoint) -> Admission:
    """Return how crowded a listener at both ports of an endpoint is; zeros where the system does not say."""
    ports = {f"{port:04X}" for port in (endpoint.port, endpoint.port + 1)}
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    waiting = sum(_waiting(table, ports) for table in _TABLES)
    return Admission(_descriptors(), limit, waiting)


def _descriptors() -> int:
    try:
        return len(os.listdir("/proc/self/fd"))
    except OSError:
        return 0


def _waiting(table: Path, ports: set[str]) -> int:
    try:
        with table.open(encoding="ascii", errors="replace") as lines:
            rows = [line.split(maxsplit=4) for line, _ in zip(lines, range(_MOST_LINES), strict=False)]
    except OSError:
        return 0
    return sum(_hangs(row, ports) for row in rows[1:])


def _hangs(row: Sequence[str], ports: set[str]) -> bool:
    """Return whether a row of the table (number, local, remote, state, ...) is of a connection in the line."""
    return len(row) > 3 and row[3] == _CLOSE_WAIT and row[1].rpartition(":")[2] in ports
