"""A PX4 that keeps the rules of its own Zenoh module: keys with type hashes, CDR, attachments, NED, Offboard at 2 Hz.

It encodes and decodes with `struct` alone, so that it shares nothing with what it tests: the alignment of C is that of
CDR. As PX4 does, it sends its whole buffer, which is longer than the message.
"""

import itertools
import math
import struct

from tests.deploy.flight.autopilot import FakeAutopilot

GID = bytes(range(1, 17))
ATTACHMENT = struct.Struct("<qqB16s")
HEADER = b"\x00\x01\x00\x00"
NAV_STATES = {"POSCTL": 2, "LOITER": 4, "OFFBOARD": 14}
OFFBOARD = "0/fmu/in/offboard_control_mode/px4_msgs::msg::dds_::OffboardControlMode_/RIHS01_"
OFFBOARD += "e87463f252f320d2f197d1feadd643b8645e5ef53a2b158dccfdf11372e00f9f"
SETPOINT = "0/fmu/in/trajectory_setpoint/px4_msgs::msg::dds_::TrajectorySetpoint_/RIHS01_"
SETPOINT += "9a7deb0cb7db5e52b441169a284b90188c4efdf06b302d55cb1db33ca0358c1a"
POSITION = "0/fmu/out/vehicle_local_position/px4_msgs::msg::dds_::VehicleLocalPosition_/RIHS01_"
POSITION += "690ad535169297241c696494adbd98bbdc45566645026fe7963513a29a1bf144"
COMMANDS = "0/fmu/in/vehicle_command/*/*"
STATUS = "0/fmu/out/vehicle_status/px4_msgs::msg::dds_::VehicleStatus_/RIHS01_"
STATUS_1_16 = STATUS + "828bddbb7d4c2aa6ad93757955f6893be1ec5d8f11885ec7715bcdd76b5226c9"
"""Of PX4 1.16 and 1.17, as PX4's page on Zenoh prints it."""
STATUS_1_18 = STATUS + "573d6f1a6c3fafbced3ec730dc37f16e96ff0596b64cc651515b31b4b3507c6f"
STATUSES = {
    STATUS_1_16: struct.Struct("@3Q3BQ3B2IH2B2?B?B5?3B11?"),
    STATUS_1_18: struct.Struct("@3Q3BQ4B?2I2B2?B?B5?3B12?"),
}
FAILSAFE = {STATUSES[STATUS_1_16]: 6, STATUSES[STATUS_1_18]: 7}
"""Number of the field `failsafe` after `nav_state`."""
LOCAL_POSITION = struct.Struct("@2Q4?3f2fBfB4f2fBfB7fB?f2?Q2df?3f2B4f?5f")
TRAILING = bytes(28)


class FakePx4(FakeAutopilot):
    """PX4 over its own Zenoh.

    Args:
        bus: its session, or that of its bridge.
        clock: seconds that never go back.
        origin: latitude and longitude of its own origin, where it knows them.
        height: at the beginning, m.
        status: key of its VehicleStatus.

    Attributes:
        valid: whether its estimator knows place and velocity.
        fault: what is wrong with its positions: version, attachment, cut or gid.
        commands: keys on which commands came, of which a bridge has none.
    """

    def __init__(self, bus, clock, origin=None, height=20.0, status=STATUS_1_18):
        super().__init__(clock, height, "POSCTL")
        self._in = [bus.subscribe(key, 256) for key in (OFFBOARD, SETPOINT, COMMANDS)]
        self._positions, self._statuses = bus.publish(POSITION), bus.publish(status)
        self._others = bus.publish(POSITION[:-64] + 64 * "0")
        self._origin, self._status, self.valid, self.fault = origin, STATUSES[status], True, ""
        self._sequences, self._gids, self._told, self.commands = {}, {}, 0, []

    def close(self):
        """Do nothing: whoever opened the session closes it."""

    def read(self):
        """Read what has come."""
        for sample in itertools.chain(*(each.drain() for each in self._in)):
            if sample.key not in (OFFBOARD, SETPOINT):
                self.commands.append(sample.key)
            elif (fault := self._fault(sample)) is not None:
                self.rejected.append(fault)
            elif sample.key == OFFBOARD:
                self.note_stream()
            else:
                numbers = struct.unpack("<Q14f", sample.payload[4:])[1:]
                self.wanted, self.yaw = list(numbers[3:6]), numbers[12]

    def _fault(self, sample):
        """Return what is wrong with a message, or None."""
        if len(sample.attachment) != 33 or sample.attachment[16] != 16:
            return "attachment"
        sequence, _, _, gid = ATTACHMENT.unpack(sample.attachment)
        if sequence != self._sequences.get(sample.key, 0) + 1 or gid != self._gids.setdefault(sample.key, gid):
            return "sequence"
        self._sequences[sample.key] = sequence
        if sample.payload[:4] != HEADER or len(sample.payload) != (19 if sample.key == OFFBOARD else 68):
            return "CDR"
        if sample.key == OFFBOARD:
            return None if sample.payload[12:] == bytes([0, 1, 0, 0, 0, 0, 0]) else "control mode"
        numbers = struct.unpack("<Q14f", sample.payload[4:])[1:]
        unknown = (*numbers[:3], *numbers[6:12], numbers[13])
        if not all(map(math.isnan, unknown)) or not all(map(math.isfinite, (*numbers[3:6], numbers[12]))):
            return "set-point"
        return None

    def tell(self, place):
        """Tell the place, and mode and arming."""
        stamp = int(1e6 * self.seconds)
        knows = self._origin is not None
        latitude, longitude = self._origin or (math.nan, math.nan)
        position = LOCAL_POSITION.pack(
            *(stamp + 500, stamp, *(self.valid,) * 4, *place, 0, 0, 0, 0, 0, *self.velocity, 0, 0, 0, 0, 0, 0),
            *(0, 0, 0, 0, 0, 0, 0, 0, True, 0, knows, knows, 0, latitude, longitude, 0, False, 0, 0, 0, 0, 0),
            *(1, 1, 1, 1, False, *(math.inf,) * 5),
        )
        if not self.mute:
            self._put(self._others if self.fault == "version" else self._positions, position, self.fault)
        rest = [0] * (len(self._status.unpack(bytes(self._status.size))) - 9)
        rest[FAILSAFE[self._status]] = self.failsafe
        state = NAV_STATES[self.mode]
        status = self._status.pack(stamp, 0, 0, 2 if self.armed else 1, 0, 0, 0, state, state, *rest)
        self._put(self._statuses, status)

    def _put(self, publisher, message, fault=""):
        self._told += 1
        attachment = ATTACHMENT.pack(self._told, int(1e6 * self.seconds), 16, bytes(16) if fault == "gid" else GID)
        whole = HEADER + (message[:-1] if fault == "cut" else message + TRAILING)
        publisher.put(whole, attachment[:-1] if fault == "attachment" else attachment)
