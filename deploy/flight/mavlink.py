"""A bridge between a vehicle's link and its autopilot over MAVLink: PX4 in Offboard, ArduPilot in Guided.

Arming, modes and every kind of recovery stay the pilot's and the autopilot's: the bridge sends heartbeats, requests for
the position's rate, and velocity set-points. Their stream ends with the flight node's and with the autopilot's
positions, so the autopilot's own time-out acts. Each new stream commands velocity 0 until the pilot gives it the go: a
change of mode, or of arming, while it streams.

In doubt the vehicle keeps its height and does not move: a set-point counts only near its height, by a fresh position.
"""

import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final

from eia_sec.common.errors import EndpointError, UsageError
from eia_sec.common.log import log
from eia_sec.common.protocol.messages import SetpointMessage
from eia_sec.deploy.flight.poses import HEIGHT
from eia_sec.deploy.flight.vehicle import Pose, VehicleLink

MASK: Final = 0b100111000111
"""Type mask: velocity and yaw count; position, acceleration and yaw rate are ignored."""
LOCAL_NED: Final = 1
"""MAV_FRAME_LOCAL_NED: x north, y east, z down."""
ONBOARD: Final = 191
"""MAV_COMP_ID_ONBOARD_COMPUTER, the bridge's component."""
AUTOPILOT: Final = 1
"""MAV_COMP_ID_AUTOPILOT1."""
STOP_SECONDS: Final = 2.0
"""Silence of the flight node after which the stream of set-points ends; until then the vehicle is told to hover."""
HEARTBEAT_SECONDS: Final = 1.0
COUNT_SECONDS: Final = 1.0
"""Time between two looks at what was refused."""
REQUEST_SECONDS: Final = 5.0
"""Time without a position after which it is asked for again."""
POSITION_RATE: Final = 10.0
"""Positions per second that are asked for."""
POSITION_SECONDS: Final = 1.0
"""Age of the newest position after which the stream of set-points ends."""
FRESH_SECONDS: Final = 0.5
"""Age of the newest position up to which the vehicle moves."""
WIND_SECONDS: Final = 5.0
"""Age after which a wind is none."""
DRIFT: Final = 2e-4
"""How much faster or slower the autopilot's clock may run."""
CLIMB_GAIN: Final = 1.0
"""Climb per metre that the height is off, 1/s."""
CLIMB: Final = 1.0
"""Fastest climb or descent, m/s."""
MOST_MESSAGES: Final = 200
"""Most messages of the autopilot that are read in a period."""


@dataclass(frozen=True)
class BridgeOptions:
    """How a bridge talks to an autopilot.

    Attributes:
        autopilot: pymavlink's connection, as udpin:0.0.0.0:14540 or /dev/ttyACM0.
        system: the vehicle's MAVLink system.
        rate: set-points per second; PX4 needs 2 at least.
        local: east and north of the autopilot's own origin in the field, m; None tells latitude and longitude.
        baud: of a serial line.
    """

    autopilot: str
    system: int = 1
    rate: float = 20.0
    local: tuple[float, float] | None = None
    baud: int = 115200


class MavlinkBridge:
    """One vehicle's bridge.

    Args:
        link: the vehicle's link to the flight node.
        options: see there.
        monotonic: seconds that never go back.

    Attributes:
        sent: set-points sent to the autopilot.
        frozen: positions whose time did not go on, or with numbers that are not finite, which are not told.
        mode: what the autopilot calls its mode, or empty before its first heartbeat.
        armed: whether it is armed.

    Raises:
        UsageError: pymavlink is not installed, or pyserial for a serial line.
        EndpointError: the connection cannot be opened.
    """

    def __init__(
        self, link: VehicleLink, options: BridgeOptions, monotonic: Callable[[], float] = time.monotonic
    ) -> None:
        self._link, self._options, self._monotonic = link, options, monotonic
        self._mav, self._wire = _connect(options)
        self._boot = monotonic()
        self._beat = self._asked = -math.inf
        self._clock = AutopilotClock()
        self._height, self._measured = 0.0, -math.inf
        self._wind: tuple[float, ...] = ()
        self._blew = -math.inf
        self._streams = self._go = False
        self._counts, self._counted = (0, 0, 0, 0), monotonic()
        self.sent = self.frozen = 0
        self.mode, self.armed = "", False

    def turn(self) -> None:
        """Process one period: tell where the vehicle is, and pass on what it has to fly."""
        now = self._monotonic()
        pose = self._read()
        if pose is not None:
            self._link.publish(pose)
        if now - self._beat >= HEARTBEAT_SECONDS:
            self._beat = now
            self._wire.mav.heartbeat_send(
                self._mav.MAV_TYPE_ONBOARD_CONTROLLER, self._mav.MAV_AUTOPILOT_INVALID, 0, 0, 0
            )
        if self.mode and now - self._asked >= REQUEST_SECONDS:
            self._asked = now
            self._request()
        self._stream(now)  # before set-points are read, so that no silence goes unseen
        setpoint = self._link.setpoint()
        self._stream(now)
        if self._streams:
            self._send(setpoint, now)
        if now - self._counted >= COUNT_SECONDS:
            self._counted = now
            self._count()

    def close(self) -> None:
        """Close the connection to the autopilot."""
        self._wire.close()

    def _count(self) -> None:
        """Log what has been refused since the last time."""
        counts = self._link.refused, self._link.lapses, self._link.untold, self.frozen
        refused, lapses, untold, frozen = (new - old for new, old in zip(counts, self._counts, strict=True))
        self._counts = counts
        if refused:
            log(f"{refused} set-points refused; the last: {self._link.complaint}")
        if lapses:
            log(f"{lapses} set-points ran out of validity; the vehicle hovered.")
        if untold:
            log(f"{untold} reports were replaced by newer ones, because there were too many.")
        if frozen:
            log(f"{frozen} positions of the autopilot are not new, or not finite.")

    def _stream(self, now: float) -> None:
        """Begin or end the stream of set-points."""
        reason = ""
        if self._link.silent >= STOP_SECONDS:
            reason = "the flight node is silent"
        elif now - self._measured >= POSITION_SECONDS:
            reason = "the autopilot's position is old"
        if self._streams == (not reason):
            return
        self._streams, self._go = not reason, False
        begun = "set-points stream; the vehicle hovers until the pilot changes its mode or arming."
        log(f"{reason}; the stream ends." if reason else begun)

    def _read(self) -> Pose | None:
        """Read what has come; return the newest pose, or None if none is new."""
        found: Any = None
        wanted = "GLOBAL_POSITION_INT" if self._options.local is None else "LOCAL_POSITION_NED"
        for _ in range(MOST_MESSAGES):
            message = self._wire.recv_msg()
            if message is None:
                break
            if (message.get_srcSystem(), message.get_srcComponent()) != (self._options.system, AUTOPILOT):
                continue
            kind = message.get_type()
            if kind == "HEARTBEAT":
                self._note_mode(message)
            elif kind == "WIND_COV":
                self._wind, self._blew = (float(message.wind_y), float(message.wind_x)), self._monotonic()
            elif kind == wanted and self._clock.goes_on(message.time_boot_ms, self._monotonic()) and _finite(message):
                found = message
            elif kind == wanted:
                self.frozen += 1
        now = self._monotonic()
        if now - self._blew > WIND_SECONDS or not all(map(math.isfinite, self._wind)):
            self._wind = ()
        if found is None:
            return None
        self._asked = now
        pose = self._global_pose(found) if self._options.local is None else self._local_pose(found, self._options.local)
        self._height, self._measured = pose.height, now - self._clock.age
        return replace(pose, age=self._clock.age)

    def _note_mode(self, message: Any) -> None:
        from pymavlink import mavutil  # noqa: PLC0415 - an extra that few users need

        mode = mavutil.mode_string_v10(message)
        armed = bool(message.base_mode & self._mav.MAV_MODE_FLAG_SAFETY_ARMED)
        if (mode, armed) != (self.mode, self.armed):
            log(f"the autopilot is {'armed' if armed else 'disarmed'}, in mode {mode}.")
            self._go = self._streams and bool(self.mode)
            self.mode, self.armed = mode, armed

    def _global_pose(self, message: Any) -> Pose:
        return Pose(
            place=(message.lat / 1e7, message.lon / 1e7),
            height=message.relative_alt / 1e3,
            velocity=(message.vy / 100.0, message.vx / 100.0),
            wind=self._wind,
            geodetic=True,
        )

    def _local_pose(self, message: Any, corner: tuple[float, float]) -> Pose:
        return Pose(
            place=(corner[0] + message.y, corner[1] + message.x),
            height=-float(message.z),
            velocity=(float(message.vy), float(message.vx)),
            wind=self._wind,
        )

    def _request(self) -> None:
        """Ask for positions at a rate; PX4 sends them by itself, ArduPilot where it is asked."""
        mav = self._mav
        kind = (
            mav.MAVLINK_MSG_ID_GLOBAL_POSITION_INT
            if self._options.local is None
            else mav.MAVLINK_MSG_ID_LOCAL_POSITION_NED
        )
        self._wire.mav.command_long_send(
            self._options.system,
            AUTOPILOT,
            mav.MAV_CMD_SET_MESSAGE_INTERVAL,
            0,
            float(kind),
            1e6 / POSITION_RATE,
            *(0.0, 0.0, 0.0, 0.0, 0.0),
        )

    def _send(self, setpoint: SetpointMessage, now: float) -> None:
        """Send a set-point: north is y and east is x; down follows from the height. In doubt all are 0."""
        east, north, down = 0.0, 0.0, 0.0
        off = setpoint.height - self._height
        if self._go and not setpoint.hover and now - self._measured <= FRESH_SECONDS and abs(off) <= HEIGHT:
            east, north = setpoint.velocity
            down = -max(-CLIMB, min(CLIMB, CLIMB_GAIN * off))
        self._wire.mav.set_position_target_local_ned_send(
            int(1e3 * (self._monotonic() - self._boot)),
            self._options.system,
            AUTOPILOT,
            LOCAL_NED,
            MASK,
            *(0.0, 0.0, 0.0),
            *(north, east, down),
            *(0.0, 0.0, 0.0),
            _heading(setpoint.yaw),
            0.0,
        )
        self.sent += 1


class AutopilotClock:
    """When positions were measured, by an autopilot's milliseconds since its start.

    The quickest message on the way tells the difference of the clocks; one that is later was measured earlier.

    Attributes:
        age: of the newest position when it was read, s.
    """

    def __init__(self) -> None:
        self._newest, self._read, self._difference = 0, -math.inf, math.inf
        self.age = 0.0

    def goes_on(self, milliseconds: int, now: float) -> bool:
        """Note a position's time; return whether it is newer than all before, or the autopilot has begun anew.

        Args:
            milliseconds: since the autopilot's start.
            now: seconds that never go back.
        """
        restarted = milliseconds < self._newest and now - self._read > POSITION_SECONDS
        if milliseconds <= self._newest and not restarted:
            return False
        known = math.inf if restarted else self._difference + DRIFT * (now - self._read)
        difference = now - milliseconds / 1e3
        self._difference = min(difference, known)
        self._newest, self._read, self.age = milliseconds, now, difference - self._difference
        return True


def _finite(message: Any) -> bool:
    """Return whether all numbers of a position are finite."""
    return all(math.isfinite(number) for number in message.to_dict().values() if isinstance(number, float))


def _heading(yaw: float) -> float:
    """Return a yaw from the field's x axis, which points east, as one from north, clockwise, in [-pi, pi)."""
    return (math.pi / 2.0 - yaw + math.pi) % (2.0 * math.pi) - math.pi


def _connect(options: BridgeOptions) -> tuple[Any, Any]:
    """Return pymavlink's dialect and a connection."""
    os.environ.setdefault("MAVLINK20", "1")
    try:
        from pymavlink import mavutil  # noqa: PLC0415 - an extra that few users need
    except ImportError:
        raise UsageError("the bridge needs the package pymavlink: pip install 'eia-sec[mavlink]'.") from None
    try:
        wire = mavutil.mavlink_connection(
            options.autopilot,
            options.baud,
            source_system=options.system,
            source_component=ONBOARD,
            dialect="common",
        )
    except ImportError:
        raise UsageError("a serial line needs the package pyserial: pip install 'eia-sec[mavlink]'.") from None
    except (OSError, ValueError, IndexError) as error:
        raise EndpointError(f"no connection to the autopilot at {options.autopilot!r}: {error}.") from error
    return mavutil.mavlink, wire
