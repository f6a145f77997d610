"""`eia-sec bridge`: connect the autopilot of a vehicle to a flight node."""

import queue
import sys
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from eia_sec.common.config.checks import positive, within
from eia_sec.common.errors import UsageError
from eia_sec.common.log import log
from eia_sec.common.names import check_name
from eia_sec.common.process import StopSignal
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import DEFAULT, Endpoint
from eia_sec.deploy.commands.policies.fly import vehicles_of
from eia_sec.deploy.flight.bridge import Bridge
from eia_sec.deploy.flight.mavlink import MavlinkAutopilot, MavlinkOptions
from eia_sec.deploy.flight.vehicle import HEIGHTS, VehicleLink
from eia_sec.deploy.options import parse

WAITING: Final = 256
"""Lines of reports that wait for the next period; reading waits for room."""


@dataclass(frozen=True)
class MavlinkArguments:
    """Connect an autopilot over MAVLink: PX4 in Offboard, ArduPilot in Guided; arming and modes stay the pilot's."""

    vehicle: str
    """The vehicle as NAME=AGENT, for example uav-7=monitoring_0."""
    autopilot: str = "udpin:127.0.0.1:14540"
    """Connection to the autopilot as pymavlink names it, udpin:0.0.0.0:14540 or /dev/ttyACM0 for instance."""
    system: int = 1
    """The vehicle's MAVLink system."""
    local: tuple[float, float] | None = None
    """East and north of the autopilot's own origin in the field, m. Default: tell latitude and longitude, and give
    --origin to `eia-sec fly`."""
    fastest: tuple[float, float] = (10.0, 10.0)
    """Largest speed along x and y that is obeyed, m/s; faster set-points are refused."""
    heights: tuple[float, float] = HEIGHTS
    """Lowest and highest height that is obeyed, m above the autopilot's home; other set-points are refused."""
    baud: int = 115200
    """Baud rate of a serial line."""
    rate: float = 20.0
    """Set-points to the autopilot and poses to the flight node per second, at least 2."""
    reports: bool = False
    """Read what the payload served from standard input: numbers of plots or sensors, a line for each report."""
    run: str = "farm"
    """Name of the run that vehicle and flight node share."""
    connect: str = DEFAULT
    """Endpoint where the flight node, a learner or a router listens."""
    tls: Path | None = None
    """Folder with the vehicle's certificate (`eia-sec keys issue vehicle NAME`); turns TLS on."""
    patience: float = 30.0
    """Seconds to wait for a listener."""


def command(arguments: Sequence[str]) -> int:
    """Pass poses and set-points on until interrupted; return 0."""
    options = parse(MavlinkArguments, _after_kind(arguments), "bridge mavlink")
    check_name(options.run, "run")
    within(2.0, 1000.0, rate=options.rate)
    within(1, 255, system=options.system)
    positive(patience=options.patience, fastest=min(options.fastest), baud=options.baud)
    if not 0.0 < options.heights[0] < options.heights[1]:
        raise UsageError("--heights takes the lowest height above the ground and a higher one, m.")
    ((vehicle, agent),) = vehicles_of([options.vehicle]).items()
    endpoint = Endpoint.parse(options.connect, options.tls)
    if endpoint.credentials is not None:
        endpoint.credentials.require("vehicle", vehicle)
    stop = StopSignal()
    stop.install()
    how = MavlinkOptions(options.autopilot, options.system, options.local, options.baud)
    with Bus.connect(endpoint, "control", options.patience, lambda: not stop) as bus:
        link = VehicleLink(bus, options.run, vehicle, agent, options.fastest, heights=options.heights)
        bridge = Bridge(link, MavlinkAutopilot(how))
        lines = _Lines() if options.reports else None
        log(f"{vehicle} flies as {agent}; its autopilot is at {options.autopilot}.")
        try:
            while not stop.event.wait(1.0 / options.rate):
                if lines is not None:
                    link.serve(lines.numbers())
                bridge.turn()
        finally:
            bridge.close()
    log(f"{bridge.sent} set-points sent, {link.refused} refused, {link.lapses} ran out of validity.")
    return 0


def _after_kind(arguments: Sequence[str]) -> list[str]:
    """Return the options after the kind of bridge; raise UsageError where it is missing."""
    if arguments and arguments[0] in ("--help", "-h"):
        return ["--help"]
    if not arguments or arguments[0] != "mavlink":
        raise UsageError("eia-sec bridge takes the kind of autopilot first: mavlink.")
    return list(arguments[1:])


class _Lines:
    """Numbers on standard input, read by a thread of their own.

    Attributes:
        unread: lines that were no numbers.
    """

    def __init__(self) -> None:
        self._waiting: queue.Queue[list[int]] = queue.Queue(WAITING)
        self.unread = 0
        threading.Thread(target=self._read, name="reports", daemon=True).start()

    def numbers(self) -> list[int]:
        """Return the numbers that have come since the last call."""
        found: list[int] = []
        while not self._waiting.empty():
            found += self._waiting.get()
        return found

    def _read(self) -> None:
        for line in sys.stdin:
            try:
                numbers = [int(word) for word in line.split()]
                if any(not 0 <= number < 2**31 for number in numbers):
                    raise ValueError
                self._waiting.put(numbers)
            except ValueError:
                self.unread += 1
                log(f"a report is no list of numbers: {line.strip()[:40]!r} ({self.unread} so far).")
