"""`eia-sec router`: a Zenoh router in its own process, with the access list when TLS is on."""

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from eia_sec.common.log import log
from eia_sec.common.process import StopSignal
from eia_sec.common.transport.admission import admission
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import DEFAULT, Endpoint
from eia_sec.common.transport.zenoh_config import document, routing
from eia_sec.deploy.exit_codes import DONE
from eia_sec.deploy.options import parse

LOOK_SECONDS: Final = 1.0
ALARM_SECONDS: Final = 60.0
"""Pause between two alarms."""


@dataclass(frozen=True)
class RouterArguments:
    """Start a router that the learner, coordinator, workers and monitors of any number of runs connect to."""

    listen: str = DEFAULT
    """Endpoint to listen on (control lane; the bulk lane uses the next port)."""
    tls: Path | None = None
    """Folder with the router's certificate (`eia-sec keys issue router NAME`); turns TLS on."""
    shared_memory: bool = False
    """Pass transitions through shared memory between processes on this machine that do the same."""
    insecure: bool = False
    """Listen on an address that other machines reach, without authentication."""
    print_config: bool = False
    """Print the configuration as JSON5 for Zenoh's own router (zenohd) and exit."""


def command(arguments: Sequence[str]) -> int:
    """Route until a signal arrives; return 0."""
    options = parse(RouterArguments, arguments, "router")
    # The printed configuration may be used in another folder.
    folder = options.tls.resolve() if options.tls is not None else None
    endpoint = Endpoint.parse(options.listen, folder, shared_memory=options.shared_memory)
    endpoint.require_private(options.insecure)
    if endpoint.credentials is not None:
        endpoint.credentials.require("router")
    if options.print_config:
        sys.stdout.write(document(routing(endpoint)))
        return DONE
    stop = StopSignal()
    stop.install()
    with Bus.route(endpoint):
        log(f"router: listening on {endpoint} and the port after it, {_admitted(endpoint)}.")
        _watch(endpoint, stop)
        log("router: stopping.")
    return DONE


def _watch(endpoint: Endpoint, stop: StopSignal) -> None:
    """Log now and then what keeps new members out, until a signal comes."""
    logged = -ALARM_SECONDS
    while not stop.event.wait(LOOK_SECONDS):
        alarms, now = admission(endpoint).alarms(), time.monotonic()
        if alarms and now - logged >= ALARM_SECONDS:
            logged = now
            for alarm in alarms:
                log(f"router: {alarm}")


def _admitted(endpoint: Endpoint) -> str:
    if endpoint.credentials is None:
        return "open to everybody who reaches it"
    return f"for {len(endpoint.credentials.members)} certificates"
