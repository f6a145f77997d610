"""How crowded a listener is: its open descriptors, and the dead connections in its accept queue.

Zenoh 1.x handles failed TLS handshakes one at a time, 100 ms each, and admits nobody meanwhile. A connection whose peer
has hung up waits in that queue and holds a descriptor. Linux shows both under /proc.
"""

import errno
import os
import resource
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from eia_sec.common.transport.endpoint import Endpoint

MOST_WAITING: Final = 20
"""Dead connections in the queue that raise no alarm yet; they delay a new member by two seconds."""
FAILURE_SECONDS: Final = 0.1
"""Delay that one failed handshake causes, s."""
CROWDED: Final = 0.5
"""Share of the process's descriptor limit above which open descriptors raise an alarm."""
_TABLES: Final = (Path("/proc/self/net/tcp"), Path("/proc/self/net/tcp6"))
_CLOSE_WAIT: Final = "08"
_MOST_LINES: Final = 65_536


@dataclass(frozen=True)
class Admission:
    """How crowded a listener is at one moment.

    Attributes:
        descriptors: open descriptors of this process.
        limit: most descriptors that it may have.
        waiting: connections to its ports that the peer has closed and this process has not.
    """

    descriptors: int
    limit: int
    waiting: int

    def metrics(self) -> dict[str, Any]:
        """Return the metrics to report."""
        return {"descriptors": self.descriptors, "waiting_connections": self.waiting}

    def alarms(self) -> list[str]:
        """Return one sentence for each condition that keeps new members out."""
        found = []
        if self.waiting > MOST_WAITING:
            found.append(
                f"{self.waiting} connections were closed by their peers before they were accepted; a new member waits "
                f"about {self.waiting * FAILURE_SECONDS:.0f} s behind them. Rate-limit new connections per address in "
                "the firewall."
            )
        if self.descriptors > CROWDED * self.limit:
            found.append(
                f"{self.descriptors} of {self.limit} descriptors are open; when none are left, nobody can connect."
            )
        return found


class AdmissionSource:
    """What a listener reports of itself. It looks once a report, because Linux takes milliseconds to print its tables.

    Args:
        endpoint: where it listens.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._newest: Admission | None = None

    def metrics(self) -> dict[str, Any]:
        """Look how crowded it is; return the metrics to report."""
        self._newest = admission(self._endpoint)
        return self._newest.metrics()

    def alarms(self) -> list[str]:
        """Return the alarms of what `metrics` found last."""
        return [] if self._newest is None else self._newest.alarms()


def raise_limit() -> None:
    """Let this process open as many descriptors as its hard limit allows; every member of a run takes two."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if resource.RLIM_INFINITY not in (soft, hard) and soft < hard:
        with suppress(OSError, ValueError):  # a sandbox may forbid it
            resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


def admission(endpoint: Endpoint) -> Admission:
    """Return how crowded this process's listener is, over both ports; zeros where /proc is missing."""
    ports = {f"{port:04X}" for port in (endpoint.port, endpoint.port + 1)}
    limit, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    waiting = sum(_waiting(table, ports) for table in _TABLES)
    return Admission(_descriptors(limit), limit, waiting)


def _descriptors(limit: int) -> int:
    try:
        return len(os.listdir("/proc/self/fd"))
    except OSError as error:
        # Listing them takes a descriptor, too.
        return limit if error.errno in (errno.EMFILE, errno.ENFILE) else 0


def _waiting(table: Path, ports: set[str]) -> int:
    try:
        with table.open(encoding="ascii", errors="replace") as lines:
            rows = [line.split(maxsplit=4) for line, _ in zip(lines, range(_MOST_LINES), strict=False)]
    except OSError:
        return 0
    return sum(_hangs(row, ports) for row in rows[1:])


def _hangs(row: Sequence[str], ports: set[str]) -> bool:
    """Return whether a table row (number, local, remote, state, ...) is a dead connection to one of the ports."""
    return len(row) > 3 and row[3] == _CLOSE_WAIT and row[1].rpartition(":")[2] in ports
