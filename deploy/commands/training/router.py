"""`eia-sec router`: a Zenoh router in its own process, with the access list when TLS is on; alone, or a site's."""

import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Final, get_args

from eia_sec.common.errors import UsageError
from eia_sec.common.log import log
from eia_sec.common.process import StopSignal
from eia_sec.common.transport.admission import admission
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import DEFAULT, Endpoint, Lane
from eia_sec.common.transport.handshake import complaint, silence
from eia_sec.common.transport.zenoh_config import document, routing
from eia_sec.deploy.exit_codes import DONE
from eia_sec.deploy.options import parse

LOOK_SECONDS: Final = 1.0
ALARM_SECONDS: Final = 60.0
"""Pause between two alarms."""
LANES: Final[tuple[Lane, ...]] = get_args(Lane)


@dataclass(frozen=True)
class RouterArguments:
    """Start a router that the learner, coordinator, workers and monitors of any number of runs connect to."""

    listen: str = DEFAULT
    """Endpoint to listen on (control lane; the bulk lane uses the next port)."""
    connect: str | None = None
    """Endpoint of the main router: this one is a site's, and passes on what comes from there and goes there."""
    tls: Path | None = None
    """Folder with the router's certificate (`eia-sec keys issue router NAME`; of a site `keys issue site NAME`); turns
    TLS on."""
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
        endpoint.credentials.require("router" if options.connect is None else "site")
    if options.print_config:
        if options.connect is not None:
            raise UsageError("--print-config is for one router, and a site has one for each lane; leave out --connect.")
        sys.stdout.write(document(routing(endpoint)))
        return DONE
    upper = Endpoint.parse(options.connect, folder) if options.connect is not None else None
    stop = StopSignal()
    stop.install()
    with ExitStack() as held:
        ways = []
        if upper is None:
            held.enter_context(Bus.route(endpoint))
        else:
            ways = [Way(held.enter_context(Bus.relay(endpoint, lane, upper)), lane, upper) for lane in LANES]
        passing = "" if upper is None else f", for {upper}"
        log(f"router: listening on {endpoint} and the port after it{passing}, {_admitted(endpoint)}.")
        _watch(endpoint, ways, stop)
        log("router: stopping.")
    return DONE


class Way:
    """A site's link to the main router for one lane, and what the log says of it."""

    def __init__(self, bus: Bus, lane: Lane, upper: Endpoint) -> None:
        self._bus, self._lane, self._upper = bus, lane, upper
        self._linked, self._said = False, -ALARM_SECONDS

    def look(self) -> str:
        """Return what is to be said now: that the link has come, or, when it is lost and now and then, why."""
        linked, now = self._bus.is_linked_to(self._upper, self._lane), time.monotonic()
        if linked == self._linked and (linked or now - self._said < ALARM_SECONDS):
            return ""
        self._linked, self._said = linked, now
        if linked:
            return f"linked to {self._upper.locator(self._lane)}."
        reason = complaint(self._upper, self._lane) or silence(self._upper, self._lane)
        return f"no link to the main router, so that this site's processes wait: {reason}"


def _watch(endpoint: Endpoint, ways: Sequence[Way], stop: StopSignal) -> None:
    """Log what becomes of links, and now and then what keeps new members out, until a signal comes."""
    logged = -ALARM_SECONDS
    while not stop.event.wait(LOOK_SECONDS):
        for way in ways:
            if sentence := way.look():
                log(f"router: {sentence}")
        alarms, now = admission(endpoint).alarms(), time.monotonic()
        if alarms and now - logged >= ALARM_SECONDS:
            logged = now
            for alarm in alarms:
                log(f"router: {alarm}")


def _admitted(endpoint: Endpoint) -> str:
    if endpoint.credentials is None:
        return "open to everybody who reaches it"
    return f"for {len(endpoint.credentials.members)} certificates"
