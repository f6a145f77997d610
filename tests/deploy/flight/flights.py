"""A flight node, a bridge and an autopilot of ours, all by one clock: over MAVLink, and over PX4's own Zenoh."""

from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import Envelope, PoseMessage, SetpointMessage
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.deploy.flight.bridge import Bridge
from eia_sec.deploy.flight.mavlink import MavlinkAutopilot, MavlinkOptions
from eia_sec.deploy.flight.px4 import Px4Autopilot
from eia_sec.deploy.flight.vehicle import VehicleLink
from tests.deploy.flight.air import Air, Clock

RUN, UAV, AGENT = "run", "uav", "monitoring_0"
PERIOD = 0.05
CORNER = (100.0, 50.0)
"""East and north of the autopilot's origin in the field, m."""


class Flight:
    """A node that sends set-points at 10 Hz, a bridge and an autopilot; `join` opens the way between the latter."""

    def __init__(self):
        self.clock, self.air = Clock(), Air()
        self._out = self.air.publish(keys.SETPOINT.key(RUN, vehicle=UAV))
        self._in = self.air.subscribe(keys.POSE.key(RUN, vehicle=UAV), 1000)
        self.link = VehicleLink(self.air, RUN, UAV, AGENT, (10.0, 10.0), self.clock, self.clock)
        self.velocity, self.node, self.hovers, self._number = (0.0, 0.0), "main", False, 0
        self.poses: list[PoseMessage] = []
        self._told = 0, 0

    def join(self, way, autopilot):
        """Take the bridge's way and what is at its end; return the flight."""
        self.way, self.autopilot, self.bridge = way, autopilot, Bridge(self.link, way, self.clock)
        return self

    def pass_time(self, seconds):
        """Let time pass."""
        for _ in range(round(seconds / PERIOD)):
            self.clock.now += PERIOD
            self._number += 1
            if self.node and self._number % 2:
                self.command(self.node, self.velocity)
            self.autopilot.turn()
            self.bridge.turn()
            for sample in self._in.drain():
                self.poses.append(PoseMessage.decode(sample.payload))
                self._told = self.poses[-1].stamp, Envelope.decode(sample.attachment).incarnation

    def command(self, node, velocity):
        """Let a node send a set-point."""
        hovers = self.hovers or not self.poses
        stamp, start = self._told
        message = SetpointMessage(
            *(AGENT, (0.0, 0.0) if hovers else velocity, (), 20.0, 0.0, (0.0, 0.0), hovers, "", 1, self._number, 0.5),
            *(stamp, 0.0, start),
        )
        self._out.put(message.encode(), Envelope("flight", node, 1, self._number).encode())

    def armed(self, mode="OFFBOARD"):
        """Let the pilot arm and choose a mode; return the flight."""
        self.pass_time(2.0)
        self.autopilot.armed = True
        assert self.autopilot.pilot_sets_mode(mode)
        return self

    def close(self):
        """Close both ends."""
        self.bridge.close()
        self.autopilot.close()


def over_mavlink(kind="px4", origin=None, height=20.0) -> Flight:
    """Return a flight over MAVLink, with UDP on loopback."""
    from tests.deploy.flight.mavlink_autopilot import FakeMavlink, free_port  # noqa: PLC0415 - an extra that may be missing

    flight, port = Flight(), free_port()
    options = MavlinkOptions(f"udpin:127.0.0.1:{port}", local=None if origin is not None else CORNER)
    way = MavlinkAutopilot(options, flight.clock)
    return flight.join(way, FakeMavlink(port, flight.clock, kind, origin, height))


def over_zenoh(origin=None, height=20.0, **options) -> Flight:
    """Return a flight over PX4's own Zenoh; both ends share a session, so that what is sent has come."""
    from tests.deploy.flight.px4_autopilot import FakePx4  # noqa: PLC0415 - as the other way is imported

    flight, bus = Flight(), Bus.listen(free_endpoint(), "control")
    autopilot = FakePx4(bus, flight.clock, origin, height, **options)
    autopilot.close = bus.close
    return flight.join(Px4Autopilot(bus, None if origin is not None else CORNER), autopilot)
