"""An autopilot that keeps MAVLink's rules over real UDP: frame LOCAL_NED, a velocity, positions where asked for."""

import os
import socket

os.environ.setdefault("MAVLINK20", "1")
import numpy as np
from pymavlink import mavutil

from tests.deploy.flight.autopilot import FakeAutopilot

M = mavutil.mavlink
PX4_MODES = {"POSCTL": (3, 0), "OFFBOARD": (6, 0), "LOITER": (4, 3)}
ARDUPILOT_MODES = {"GUIDED": 4, "LOITER": 5}
POSITION_IGNORED, ACCELERATION_IGNORED, YAW_IGNORED = 7, 448, 1024


def free_port() -> int:
    """Return a UDP port on loopback that nobody uses now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


class FakeMavlink(FakeAutopilot):
    """PX4 or ArduPilot over MAVLink.

    Args:
        port: where the bridge listens.
        clock: seconds that never go back.
        kind: px4 or ardupilot.
        origin: TangentPlane at its own origin, for latitude and longitude.
        height: at the beginning, m.
    """

    def __init__(self, port, clock, kind="px4", origin=None, height=20.0):
        super().__init__(clock, height, "POSCTL" if kind == "px4" else "LOITER")
        self._wire = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{port}", source_system=1, source_component=1, dialect="common"
        )
        self.kind, self._origin, self._beat, self._asked, self.commands = kind, origin, clock(), kind == "px4", []

    def close(self):
        """Close the connection."""
        self._wire.close()

    def read(self):
        """Read what has come."""
        while (message := self._wire.recv_msg()) is not None:
            kind = message.get_type()
            if kind == "COMMAND_LONG" and message.command == M.MAV_CMD_SET_MESSAGE_INTERVAL:
                self._asked = True
            elif kind == "COMMAND_LONG":
                self.commands.append(message.command)
            elif kind == "SET_POSITION_TARGET_LOCAL_NED":
                self._take(message)

    def _take(self, message):
        mask = message.type_mask
        if message.target_system != 1:
            self.rejected.append("system")
        elif message.coordinate_frame != M.MAV_FRAME_LOCAL_NED:
            self.rejected.append("frame")
        elif (
            mask & 56
            or mask & POSITION_IGNORED != POSITION_IGNORED
            or mask & ACCELERATION_IGNORED != ACCELERATION_IGNORED
        ):
            self.rejected.append("mask")
        else:
            self.note_stream()
            self.wanted = [message.vx, message.vy, message.vz]
            if not mask & YAW_IGNORED:
                self.yaw = message.yaw

    def tell(self, place):
        """Tell the place, and mode and arming."""
        tells, stamp = self._asked and not self.mute, int(1e3 * self.seconds)
        if tells:
            self._wire.mav.local_position_ned_send(stamp, *place, *self.velocity)
        if tells and self._origin is not None:
            longitude, latitude = self._origin.to_degrees(np.array([[self.place[1], self.place[0]]]))[0]
            height, speeds = int(-1e3 * self.place[2]), [int(100 * speed) for speed in self.velocity]
            self._wire.mav.global_position_int_send(
                stamp, round(latitude * 1e7), round(longitude * 1e7), height, height, *speeds, 0
            )
        now = self._clock()
        if now - self._beat >= 0.2:
            self._beat = now
            base = M.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (M.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)
            if self.kind == "px4":
                main, sub = PX4_MODES[self.mode]
                autopilot, custom = M.MAV_AUTOPILOT_PX4, main << 16 | sub << 24
            else:
                autopilot, custom = M.MAV_AUTOPILOT_ARDUPILOTMEGA, ARDUPILOT_MODES[self.mode]
            self._wire.mav.heartbeat_send(M.MAV_TYPE_QUADROTOR, autopilot, base, custom, 5 if self.failsafe else 4)
