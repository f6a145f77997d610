"""The way to PX4 over its own Zenoh module (PX4 1.16 and later), in Offboard."""

import math
import secrets
import time
from collections.abc import Iterator
from typing import Any, Final

from eia_sec.common.errors import ProtocolError, SchemaError
from eia_sec.common.log import log
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.keys import Px4Topic
from eia_sec.common.transport.bus import Bus, Sample, Subscription
from eia_sec.deploy.flight.bridge import Mode, Ned, Position, pose_of
from eia_sec.deploy.flight.px4_messages import ATTACHMENT, DEFINITIONS, GID, STATUS, MessageType, gid_of
from eia_sec.deploy.flight.vehicle import Pose

WAITING: Final = 64
"""Messages of a topic that wait to be read; the oldest are dropped."""
ARMED: Final = 2
"""ARMING_STATE_ARMED."""
MODES: Final = {
    0: "MANUAL",
    1: "ALTCTL",
    2: "POSCTL",
    3: "MISSION",
    4: "LOITER",
    5: "RTL",
    12: "DESCEND",
    14: "OFFBOARD",
    15: "STABILIZED",
    17: "TAKEOFF",
    18: "LAND",
}
"""Names of nav_state's values; others are told as numbers."""
EARTH: Final = 6_371_000.0
"""Radius of the sphere on which PX4 projects, m."""
UNKNOWN: Final = (math.nan,) * 3
"""What PX4 is not to control."""


class Px4Autopilot:
    """PX4 over its own Zenoh: OffboardControlMode and TrajectorySetpoint go there, place and status come from it.

    Args:
        bus: the session to which PX4 connects.
        local: east and north of PX4's own origin in the field, m; None tells latitude and longitude.

    Attributes:
        refused: messages of PX4 that were not understood.

    Raises:
        UsageError: rosbags is not installed.
    """

    def __init__(self, bus: Bus, local: tuple[float, float] | None = None) -> None:
        self._local = local
        offboard, setpoint, position = (MessageType.of(name, text) for name, text in DEFINITIONS.items())
        status = [MessageType.of("VehicleStatus", text) for text in STATUS]
        self._gid, self._theirs = secrets.token_bytes(GID), b""
        self._offboard = _Publisher(bus, keys.PX4_OFFBOARD, offboard, self._gid)
        self._setpoint = _Publisher(bus, keys.PX4_SETPOINT, setpoint, self._gid)
        self._positions = _Reader(bus, keys.PX4_POSITION, [position])
        self._statuses = _Reader(bus, keys.PX4_STATUS, status)
        self._said: set[str] = set()
        self.refused = 0

    def read(self) -> list[Position | Mode]:
        """Return what has come: modes, then positions, the oldest of each first."""
        found: list[Position | Mode] = []
        for status in self._understood(self._statuses):
            mode = MODES.get(status.nav_state, str(status.nav_state))
            found.append(Mode(mode, status.arming_state == ARMED, bool(status.failsafe)))
        for position in self._understood(self._positions):
            pose = self._pose(position)
            if pose is None:
                self._say("PX4 does not know its place, height or velocity, so the vehicle is not told of.")
            else:
                found.append(Position(pose, position.timestamp_sample / 1e6))
        return found

    def send(self, velocity: Ned, heading: float) -> None:
        """Send a set-point of velocity and heading, and before it what keeps PX4 in Offboard."""
        self._offboard.put(velocity=True)
        self._setpoint.put(
            position=UNKNOWN, velocity=velocity, acceleration=UNKNOWN, jerk=UNKNOWN, yaw=heading, yawspeed=math.nan
        )

    def close(self) -> None:
        """Do nothing: the session belongs to whoever opened it."""

    def _understood(self, reader: "_Reader") -> Iterator[Any]:
        """Yield the messages of a topic that are those of this vehicle's PX4."""
        for sample in reader.samples():
            try:
                gid = gid_of(sample.attachment)
                self._theirs = self._theirs or gid
                if gid != self._theirs:
                    raise ProtocolError("another PX4 than the first one tells its place; give each a bridge.")
                yield reader.decode(sample)
            except ProtocolError as error:
                self.refused += 1
                self._say(f"refused: {error}")

    def _pose(self, position: Any) -> Pose | None:
        if not (position.xy_valid and position.z_valid and position.v_xy_valid):
            return None
        place, velocity = (position.x, position.y, position.z), (position.vx, position.vy, position.vz)
        if self._local is not None:
            return pose_of(place, velocity, self._local)
        if not position.xy_global:
            return None
        pose = pose_of(place, velocity, (0.0, 0.0))
        degrees = to_degrees((position.ref_lat, position.ref_lon), position.x, position.y)
        return Pose(degrees, pose.height, pose.velocity, geodetic=True)

    def _say(self, reason: str) -> None:
        """Log a reason once."""
        if reason not in self._said:
            self._said.add(reason)
            log(reason)


class _Publisher:
    """What the bridge publishes of one type."""

    def __init__(self, bus: Bus, topic: Px4Topic, kind: MessageType, gid: bytes) -> None:
        self._kind, self._gid, self._sequence = kind, gid, 0
        self._publisher = bus.publish(topic.key(kind.type_hash))

    def put(self, **values: Any) -> None:
        """Publish a message; PX4 replaces its time stamp by its own."""
        self._sequence += 1
        attachment = ATTACHMENT.pack(self._sequence, time.time_ns(), GID, self._gid)
        self._publisher.put(self._kind.encode(**values), attachment)


class _Reader:
    """What PX4 tells of one topic, in any of some versions."""

    def __init__(self, bus: Bus, topic: Px4Topic, kinds: list[MessageType]) -> None:
        self._subscription: Subscription = bus.subscribe(topic.key("*"), WAITING)
        self._kind, self._kinds = topic.kind, {kind.type_hash: kind for kind in kinds}

    def samples(self) -> Iterator[Sample]:
        """Yield what has arrived."""
        return self._subscription.drain()

    def decode(self, sample: Sample) -> Any:
        """Return the message; raise SchemaError for another version than those, or where it is none."""
        kind = self._kinds.get(sample.key.rpartition("/")[2])
        if kind is None:
            raise SchemaError(f"PX4 has another version of {self._kind} than 1.16 to 1.18.")
        return kind.decode(sample.payload)


def to_degrees(origin: tuple[float, float], north: float, east: float) -> tuple[float, float]:
    """Return the latitude and longitude that PX4 means by a place of its own frame: the inverse of its projection.

    PX4 projects azimuthally and equidistantly on a sphere, 0.3 % off the ellipsoid; its inverse gives back what it
    has measured.

    Args:
        origin: latitude and longitude of its origin, degrees.
        north: m.
        east: m.
    """
    latitude, longitude = map(math.radians, origin)
    x, y = north / EARTH, east / EARTH
    angle = math.hypot(x, y)
    if not math.isfinite(latitude + longitude + angle):
        return math.nan, math.nan
    if angle == 0.0:
        return origin
    sine, cosine = math.sin(angle), math.cos(angle)
    high = cosine * math.sin(latitude) + x * sine * math.cos(latitude) / angle
    turn = math.atan2(y * sine, angle * math.cos(latitude) * cosine - x * math.sin(latitude) * sine)
    return math.degrees(math.asin(max(-1.0, min(1.0, high)))), math.degrees(longitude + turn)
