"""The way to an autopilot over MAVLink: PX4 in Offboard, ArduPilot in Guided."""

import math
import os
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from eia_sec.common.errors import EndpointError, UsageError
from eia_sec.deploy.flight.bridge import Mode, Ned, Position, pose_of
from eia_sec.deploy.flight.vehicle import Pose

MASK: Final = 0b100111000111
"""Type mask: velocity and yaw count; position, acceleration and yaw rate are ignored."""
LOCAL_NED: Final = 1
"""MAV_FRAME_LOCAL_NED: x north, y east, z down."""
ONBOARD: Final = 191
"""MAV_COMP_ID_ONBOARD_COMPUTER, the bridge's component."""
AUTOPILOT: Final = 1
"""MAV_COMP_ID_AUTOPILOT1."""
HEARTBEAT_SECONDS: Final = 1.0
REQUEST_SECONDS: Final = 5.0
"""Time without a position after which it is asked for again."""
POSITION_RATE: Final = 10.0
"""Positions per second that are asked for."""
WIND_SECONDS: Final = 5.0
"""Age after which a wind is none."""
MOST_MESSAGES: Final = 200
"""Most messages of the autopilot that are read in a period."""


@dataclass(frozen=True)
class MavlinkOptions:
    """How to talk to an autopilot.

    Attributes:
        autopilot: pymavlink's connection, as udpin:0.0.0.0:14540 or /dev/ttyACM0.
        system: the vehicle's MAVLink system.
        local: east and north of the autopilot's own origin in the field, m; None tells latitude and longitude.
        baud: of a serial line.
    """

    autopilot: str
    system: int = 1
    local: tuple[float, float] | None = None
    baud: int = 115200


class MavlinkAutopilot:
    """An autopilot over MAVLink: heartbeats, requests for the position's rate, and velocity set-points go there.

    Args:
        options: see there.
        monotonic: seconds that never go back.

    Raises:
        UsageError: pymavlink is not installed, or pyserial for a serial line.
        EndpointError: the connection cannot be opened.
    """

    def __init__(self, options: MavlinkOptions, monotonic: Callable[[], float] = time.monotonic) -> None:
        self._options, self._monotonic = options, monotonic
        self._mav, self._wire = _connect(options)
        self._boot = monotonic()
        self._beat = self._asked = self._blew = -math.inf
        self._wind: tuple[float, ...] = ()
        self._answers = False

    def read(self) -> list[Position | Mode]:
        """Return what has come, the oldest first; send a heartbeat, or a request for positions, that is due.

        Raises:
            EndpointError: the connection broke, as a serial line does that is unplugged.
        """
        now = self._monotonic()
        wanted = "GLOBAL_POSITION_INT" if self._options.local is None else "LOCAL_POSITION_NED"
        found: list[Position | Mode] = []
        for _ in range(MOST_MESSAGES):
            message = self._next()
            if message is None:
                break
            if (message.get_srcSystem(), message.get_srcComponent()) != (self._options.system, AUTOPILOT):
                continue
            kind = message.get_type()
            if kind == "HEARTBEAT":
                self._answers = True
                found.append(self._mode(message))
            elif kind == "WIND_COV":
                self._wind, self._blew = (float(message.wind_y), float(message.wind_x)), now
            elif kind == wanted:
                self._asked = now
                found.append(Position(self._pose(message, now), message.time_boot_ms / 1e3))
        if now - self._beat >= HEARTBEAT_SECONDS:
            self._beat = now
            self._wire.mav.heartbeat_send(
                self._mav.MAV_TYPE_ONBOARD_CONTROLLER, self._mav.MAV_AUTOPILOT_INVALID, 0, 0, 0
            )
        if self._answers and now - self._asked >= REQUEST_SECONDS:
            self._asked = now
            self._request()
        return found

    def send(self, velocity: Ned, heading: float) -> None:
        """Send a set-point of velocity and heading."""
        self._wire.mav.set_position_target_local_ned_send(
            int(1e3 * (self._monotonic() - self._boot)) % 2**32,  # it begins anew after 49 days
            self._options.system,
            AUTOPILOT,
            LOCAL_NED,
            MASK,
            *(0.0, 0.0, 0.0),
            *velocity,
            *(0.0, 0.0, 0.0),
            heading,
            0.0,
        )

    def close(self) -> None:
        """Close the connection to the autopilot."""
        self._wire.close()

    def _next(self) -> Any:
        """Return the next message, or None if none waits."""
        try:
            return self._wire.recv_msg()
        except OSError as error:
            raise EndpointError(
                f"the connection to the autopilot at {self._options.autopilot!r} broke: {error}."
            ) from error

    def _mode(self, message: Any) -> Mode:
        from pymavlink import mavutil  # noqa: PLC0415 - an extra that few users need

        armed = bool(message.base_mode & self._mav.MAV_MODE_FLAG_SAFETY_ARMED)
        failsafe = message.system_status >= self._mav.MAV_STATE_CRITICAL
        return Mode(mavutil.mode_string_v10(message), armed, failsafe)

    def _pose(self, message: Any, now: float) -> Pose:
        if now - self._blew > WIND_SECONDS or not all(map(math.isfinite, self._wind)):
            self._wind = ()
        if self._options.local is not None:
            place, velocity = (message.x, message.y, message.z), (message.vx, message.vy, message.vz)
            return pose_of(place, velocity, self._options.local, self._wind)
        return Pose(
            place=(message.lat / 1e7, message.lon / 1e7),
            height=message.relative_alt / 1e3,
            velocity=(message.vy / 100.0, message.vx / 100.0),
            wind=self._wind,
            geodetic=True,
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


def _connect(options: MavlinkOptions) -> tuple[Any, Any]:
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
