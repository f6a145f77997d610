"""An autopilot that keeps MAVLink's rules over real UDP: what a bridge is tested against. It has never flown anything.

PX4: Offboard may be entered once set-points have streamed at 2 Hz for a second, and is left half a second after they
end; then the vehicle loiters. ArduPilot: Guided holds, and the vehicle stops 3 seconds after the last set-point;
positions are sent where somebody asks for them. Both follow set-points only where they are armed and in that mode, in
the frame LOCAL_NED, and with a velocity.
"""

import math
import os
import socket

os.environ.setdefault("MAVLINK20", "1")
import numpy as np
from pymavlink import mavutil

M = mavutil.mavlink
ACCELERATION = 5.0
STREAM_GAP = 0.5
"""Longest pause between set-points of a stream of 2 Hz, s."""
PX4_MODES = {"POSCTL": (3, 0), "OFFBOARD": (6, 0), "LOITER": (4, 3)}
ARDUPILOT_MODES = {"GUIDED": 4, "LOITER": 5}
POSITION_IGNORED, ACCELERATION_IGNORED, YAW_IGNORED, YAW_RATE_IGNORED = 7, 448, 1024, 2048


def free_port() -> int:
    """Return a UDP port on loopback that nobody uses now."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


class FakeAutopilot:
    """One vehicle, moved by `turn`.

    Args:
        port: where the bridge listens.
        kind: px4 or ardupilot.
        clock: seconds that never go back.
        origin: TangentPlane at its own origin, for latitude and longitude.
        height: at the beginning, m.
        system: its MAVLink system.

    Attributes:
        mute: whether it keeps its position for itself.
        frozen: whether its positions' time stands still.
        broken: whether its positions are no numbers.
    """

    def __init__(self, port, clock, kind="px4", origin=None, height=20.0, system=1):
        self._wire = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{port}", source_system=system, source_component=1, dialect="common"
        )
        self._clock, self.kind, self._origin, self.system = clock, kind, origin, system
        self.mode, self.armed, self.frozen = "POSCTL" if kind == "px4" else "LOITER", False, False
        self.place, self.velocity, self.wanted, self.yaw = [0.0, 0.0, -height], [0.0] * 3, [0.0] * 3, 0.0
        self._begin = self._last = self._beat = clock()
        self._stamp = 1
        self._asked, self.mute, self.broken = kind == "px4", False, False
        self._gap_since = self._latest = -math.inf
        self.accepted, self.rejected, self.commands, self.failsafes = 0, [], [], 0

    def pilot_sets_mode(self, mode) -> bool:
        """Let the pilot choose a mode; return whether the autopilot takes it."""
        now = self._clock()
        streams = now - self._latest <= STREAM_GAP and now - self._gap_since >= 1.0
        if mode == "OFFBOARD" and not streams:
            return False
        self.mode = mode
        return True

    def turn(self):
        """Read, move and tell."""
        now = self._clock()
        self._read(now)
        flies = self.armed and self.mode in ("OFFBOARD", "GUIDED")
        if self.mode == "OFFBOARD" and now - self._latest > STREAM_GAP:
            self.mode, self.failsafes = "LOITER", self.failsafes + 1
            flies = False
        if self.mode == "GUIDED" and now - self._latest > 3.0:
            flies = False
        dt, self._last = now - self._last, now
        self.move(self.wanted if flies else [0.0] * 3, dt)
        self._tell(now)

    def move(self, wanted, dt):
        """Fly towards a velocity for some time, north, east and down."""
        for axis in range(3):
            change = max(-ACCELERATION * dt, min(ACCELERATION * dt, wanted[axis] - self.velocity[axis]))
            self.velocity[axis] += change
            self.place[axis] += self.velocity[axis] * dt

    def close(self):
        """Close the connection."""
        self._wire.close()

    def _read(self, now):
        while (message := self._wire.recv_msg()) is not None:
            kind = message.get_type()
            if kind == "COMMAND_LONG":
                self.commands.append(message.command)
                self._asked |= message.command == M.MAV_CMD_SET_MESSAGE_INTERVAL
            elif kind == "SET_POSITION_TARGET_LOCAL_NED":
                self._take(message, now)

    def _take(self, message, now):
        mask = message.type_mask
        if message.target_system != self.system:
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
            if now - self._latest > STREAM_GAP:
                self._gap_since = now
            self._latest, self.accepted = now, self.accepted + 1
            self.wanted = [message.vx, message.vy, message.vz]
            if not mask & YAW_IGNORED:
                self.yaw = message.yaw

    def _tell(self, now):
        if not self.frozen:
            self._stamp = 1 + int(1e3 * (now - self._begin))
        tells = self._asked and not self.mute
        if tells:
            place = [math.nan] * 3 if self.broken else self.place
            self._wire.mav.local_position_ned_send(self._stamp, *place, *self.velocity)
        if tells and self._origin is not None:
            longitude, latitude = self._origin.to_degrees(np.array([[self.place[1], self.place[0]]]))[0]
            height, speeds = int(-1e3 * self.place[2]), [int(100 * speed) for speed in self.velocity]
            self._wire.mav.global_position_int_send(
                self._stamp, round(latitude * 1e7), round(longitude * 1e7), height, height, *speeds, 0
            )
        if now - self._beat >= 0.2:
            self._beat = now
            base = M.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (M.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)
            if self.kind == "px4":
                main, sub = PX4_MODES[self.mode]
                autopilot, custom = M.MAV_AUTOPILOT_PX4, main << 16 | sub << 24
            else:
                autopilot, custom = M.MAV_AUTOPILOT_ARDUPILOTMEGA, ARDUPILOT_MODES[self.mode]
            self._wire.mav.heartbeat_send(M.MAV_TYPE_QUADROTOR, autopilot, base, custom, 4)
