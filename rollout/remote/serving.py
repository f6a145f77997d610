"""Serves a PettingZoo parallel environment to the workers of a run; see `serve`."""

import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from eia_sec.common.clock import monotonic
from eia_sec.common.errors import EndpointError
from eia_sec.common.incarnation import new_incarnation
from eia_sec.common.log import log, name_process
from eia_sec.common.names import check_name
from eia_sec.common.protocol import keys
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import DEFAULT, Endpoint
from eia_sec.rollout.remote.copies import Copies
from eia_sec.rollout.remote.desk import Desk

CAPACITY: Final = 64
"""Requests that may wait while the environment steps; one more ends the oldest, which its worker sends again."""
NAMESAKE_SECONDS: Final = 10.0
"""Time after which a former process of this name is gone, unless it is still served."""
LOOK_SECONDS: Final = 0.2
"""Pause between two looks for another process of this name."""
SAID_SECONDS: Final = 60.0
"""Pause between two log lines about a listener that does not answer."""


def serve(environment: Any, name: str = "", connect: str = DEFAULT, *, tls: str | Path | None = None) -> None:
    """Serve an environment until the process is interrupted.

    Workers of `eia-sec train --env "zenoh:NAME"` step it. It runs in the calling thread. The listener need not be there
    yet, and may go and come back. If the environment's own code raises anything but `EnvironmentOutageError`, its
    worker is told, and the exception passes through: start the program again, and training goes on with it.

    Args:
        environment: a PettingZoo parallel environment, or a list of several alike, which one message steps together.
        name: its name among all environments, 1 to 63 letters, digits, `.`, `_` or `-`; by default the certificate's.
        connect: where the learner or a router listens, tcp/HOST:PORT.
        tls: folder of the environment's certificate (`eia-sec keys issue environment NAME`); turns TLS on.

    Raises:
        ConfigError: the name is no name.
        ContractError: it is no such environment, or its spaces do not travel.
        CredentialsError: the certificate cannot be used.
        EndpointError: the endpoint is malformed, or another process serves this name there.
    """
    endpoint = Endpoint.parse(connect, None if tls is None else Path(tls))
    if endpoint.credentials is not None:
        name = name or endpoint.credentials.identity.name
        endpoint.credentials.require("environment", name)
    check_name(name, "name")
    name_process("environment", name)
    several = isinstance(environment, Sequence)
    copies = Copies(environment if several else [environment])
    with _connected(endpoint) as bus:
        _require_unserved(bus, name)
        desk = Desk(copies, new_incarnation(), monotonic)
        requests = bus.serve(keys.ENVIRONMENT.pattern(environment=name), CAPACITY, newest=True)
        token = bus.announce(keys.ENVIRONMENT_LIVE.key(environment=name))
        log(f"environment {name} is served at {endpoint}.")
        told = _Told(name, desk)
        for incoming in requests:
            incoming.reply(desk.answer(incoming.key.rpartition("/")[2], incoming.payload))
            told.say()
            if desk.failure is not None:
                del token
                raise desk.failure


def _connected(endpoint: Endpoint) -> Bus:
    said = [-math.inf]

    def waiting() -> bool:
        if monotonic() - said[0] >= SAID_SECONDS:
            said[0] = monotonic()
            log(f"waiting for a listener at {endpoint}.")
        return True

    return Bus.connect(endpoint, "control", wait=math.inf, waiting=waiting)


def _require_unserved(bus: Bus, name: str) -> None:
    """Raise EndpointError if another process serves this name; one that has just died may still seem to live."""
    key, deadline = keys.ENVIRONMENT_LIVE.key(environment=name), monotonic() + NAMESAKE_SECONDS
    while bus.living(key):
        if monotonic() > deadline:
            raise EndpointError(f"another process serves an environment named {name} there; choose another name.")
        time.sleep(LOOK_SECONDS)


class _Told:
    """Logs who takes the environment, and the first request of each kind that was not carried out."""

    def __init__(self, name: str, desk: Desk) -> None:
        self._name, self._desk = name, desk
        self._holder = ""
        self._counts: dict[str, int] = {}

    def say(self) -> None:
        """Log what has changed."""
        desk = self._desk
        if desk.holder != self._holder:
            counts = ", ".join(f"{count} {what}" for what, count in sorted(desk.counts.items())) or "none"
            taken = f"is taken by {desk.holder}" if desk.holder else f"is released by {self._holder}"
            log(f"environment {self._name} {taken}; requests not carried out so far: {counts}.")
            self._holder = desk.holder
        for what in desk.counts.keys() - self._counts.keys():
            log(f"environment {self._name} counts a request that was {what}.")
            self._counts[what] = 1
