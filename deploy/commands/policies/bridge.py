"""`eia-sec bridge`: connect the autopilot of a vehicle to a flight node."""

import queue
import sys
import threading
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Final

import tyro

from eia_sec.common.config.checks import positive, within
from eia_sec.common.errors import UsageError
from eia_sec.common.log import log
from eia_sec.common.names import check_name
from eia_sec.common.process import StopSignal
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import DEFAULT, Endpoint
from eia_sec.deploy.commands.policies.fly import vehicles_of
from eia_sec.deploy.flight.bridge import Autopilot, Bridge
from eia_sec.deploy.flight.mavlink import MavlinkAutopilot, MavlinkOptions
from eia_sec.deploy.flight.px4 import Px4Autopilot
from eia_sec.deploy.flight.vehicle import HEIGHTS, VehicleLink
from eia_sec.deploy.listener import connected
from eia_sec.deploy.options import parse

WAITING: Final = 256
"""Lines of reports that wait for the next period; reading waits for room."""


@dataclass(frozen=True)
class _Arguments:
    vehicle: str
    """The vehicle as NAME=AGENT, for example uav-7=monitoring_0."""
    local: tuple[float, float] | None = None
    """East and north of the autopilot's own origin in the field, m. Default: tell latitude and longitude, and give
    --origin to `eia-sec fly`."""
    fastest: tuple[float, float] = (10.0, 10.0)
    """Largest speed along x and y that is obeyed, m/s; faster set-points are refused."""
    heights: tuple[float, float] = HEIGHTS
    """Lowest and highest height that is obeyed, m above the autopilot's home; other set-points are refused."""
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


@dataclass(frozen=True)
class MavlinkArguments(_Arguments):
    """Connect an autopilot over MAVLink: PX4 in Offboard, ArduPilot in Guided; arming and modes stay the pilot's."""

    autopilot: str = "udpin:127.0.0.1:14540"
    """Connection to the autopilot as pymavlink names it, udpin:0.0.0.0:14540 or /dev/ttyACM0 for instance."""
    system: int = 1
    """The vehicle's MAVLink system."""
    baud: int = 115200
    """Baud rate of a serial line."""


@dataclass(frozen=True)
class Px4Arguments(_Arguments):
    """Connect PX4 over its own Zenoh module, in Offboard; arming and modes stay the pilot's."""

    autopilot: str = "tcp/127.0.0.1:7449"
    """Endpoint where the bridge listens for PX4 (`zenoh config net client tcp/127.0.0.1:7449` on PX4)."""
    insecure: bool = False
    """Let the bridge listen beyond this machine, though PX4's Zenoh has no certificate: for a cable of its own."""


@dataclass(frozen=True)
class BridgeArguments:
    """Connect a vehicle's autopilot to `eia-sec fly`, in the protocol that it speaks."""

    kind: Annotated[
        Annotated[MavlinkArguments, tyro.conf.subcommand("mavlink")]
        | Annotated[Px4Arguments, tyro.conf.subcommand("px4")],
        tyro.conf.arg(name=""),
    ]


def command(arguments: Sequence[str]) -> int:
    """Pass poses and set-points on until interrupted; return 0."""
    options = parse(BridgeArguments, arguments, "bridge").kind
    check_name(options.run, "run")
    within(2.0, 1000.0, rate=options.rate)
    positive(patience=options.patience, fastest=min(options.fastest))
    if not 0.0 < options.heights[0] < options.heights[1]:
        raise UsageError("--heights takes the lowest height above the ground and a higher one, m.")
    if isinstance(options, MavlinkArguments):
        within(1, 255, system=options.system)
        positive(baud=options.baud)
    else:
        listens = Endpoint.parse(options.autopilot)
        if not (listens.is_loopback or options.insecure):
            raise UsageError(
                f"whoever reaches {listens} before PX4 does can pretend to be it, and PX4's Zenoh has no certificate; "
                "give the bridge an address of this machine alone, or of a cable of its own with --insecure."
            )
    ((vehicle, agent),) = vehicles_of([options.vehicle]).items()
    endpoint = Endpoint.parse(options.connect, options.tls)
    if endpoint.credentials is not None:
        endpoint.credentials.require("vehicle", vehicle)
    stop = StopSignal()
    stop.install()
    with ExitStack() as opened:
        bus = opened.enter_context(connected(endpoint, options.patience, lambda: not stop))
        link = VehicleLink(bus, options.run, vehicle, agent, options.fastest, heights=options.heights)
        bridge = Bridge(link, _autopilot(options, opened))
        opened.callback(bridge.close)
        lines = _Lines() if options.reports else None
        log(f"{vehicle} flies as {agent}; its autopilot is at {options.autopilot}.")
        while not stop.event.wait(1.0 / options.rate):
            if lines is not None:
                link.serve(lines.numbers())
            bridge.turn()
    log(f"{bridge.sent} set-points sent, {link.refused} refused, {link.lapses} ran out of validity.")
    return 0


def _autopilot(options: MavlinkArguments | Px4Arguments, opened: ExitStack) -> Autopilot:
    """Return the way to the autopilot; what it needs is closed with `opened`."""
    if isinstance(options, MavlinkArguments):
        how = MavlinkOptions(options.autopilot, options.system, options.local, options.baud)
        return MavlinkAutopilot(how)
    bus = opened.enter_context(Bus.admit_px4(Endpoint.parse(options.autopilot)))
    return Px4Autopilot(bus, options.local)


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
