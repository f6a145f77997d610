"""The MAVLink bridge against an autopilot that keeps the protocol's rules, over UDP on loopback."""

import math

import numpy as np
import pytest

from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import Envelope, PoseMessage, SetpointMessage
from eia_sec.deploy.flight.bridge import CLIMB, STOP_SECONDS, AutopilotClock, Bridge, Mode
from eia_sec.deploy.flight.mavlink import MASK, MavlinkAutopilot, MavlinkOptions
from eia_sec.deploy.flight.vehicle import VehicleLink
from eia_sec.rollout.farm_files.projection import TangentPlane
from tests.deploy.flight.air import Air, Clock
from tests.deploy.flight.mavlink_autopilot import FakeMavlink, M, free_port

RUN, UAV, AGENT = "run", "uav", "monitoring_0"
PERIOD = 0.05


class Flight:
    """A node that sends set-points at 10 Hz, a bridge and an autopilot, all by one clock."""

    def __init__(self, kind="px4", origin=None, height=20.0):
        self.clock, self.air, port = Clock(), Air(), free_port()
        self._out = self.air.publish(keys.SETPOINT.key(RUN, vehicle=UAV))
        self._in = self.air.subscribe(keys.POSE.key(RUN, vehicle=UAV), 1000)
        self.link = VehicleLink(self.air, RUN, UAV, AGENT, (10.0, 10.0), self.clock, self.clock)
        local = None if origin is not None else (100.0, 50.0)
        options = MavlinkOptions(f"udpin:127.0.0.1:{port}", local=local)
        self.way = MavlinkAutopilot(options, self.clock)
        self.bridge = Bridge(self.link, self.way, self.clock)
        self.autopilot = FakeMavlink(port, self.clock, kind, origin, height)
        self.velocity, self.node, self.hovers, self._number = (0.0, 0.0), True, False, 0
        self.poses: list[PoseMessage] = []
        self._told = 0, 0

    def pass_time(self, seconds):
        """Let time pass."""
        for _ in range(round(seconds / PERIOD)):
            self.clock.now += PERIOD
            self._number += 1
            if self.node and self._number % 2:
                hovers = self.hovers or not self.poses
                velocity = (0.0, 0.0) if hovers else self.velocity
                stamp, start = self._told
                message = SetpointMessage(
                    *(AGENT, velocity, (), 20.0, 0.0, (0.0, 0.0), hovers, "", 1, self._number, 0.5),
                    *(stamp, 0.0, start),
                )
                self._out.put(message.encode(), Envelope("flight", "main", 1, self._number).encode())
            self.autopilot.turn()
            self.bridge.turn()
            for sample in self._in.drain():
                self.poses.append(PoseMessage.decode(sample.payload))
                self._told = self.poses[-1].stamp, Envelope.decode(sample.attachment).incarnation

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


@pytest.fixture
def flight():
    """A flight with PX4 that is armed and in Offboard."""
    found = Flight().armed()
    yield found
    found.close()


def test_velocities_fly_east_and_north_at_the_height_of_the_type():
    """The field's x is east and y is north, the height is reached and held, and the nose points east."""
    flight = Flight(height=18.1).armed()
    flight.velocity = (4.0, -1.5)
    flight.pass_time(0.6)
    assert -flight.autopilot.velocity[2] == pytest.approx(CLIMB)
    flight.pass_time(9.0)
    north, east, down = flight.autopilot.velocity
    assert (east, north) == pytest.approx((4.0, -1.5), abs=1e-5)
    assert down == pytest.approx(0.0, abs=0.02)
    assert -flight.autopilot.place[2] == pytest.approx(20.0, abs=0.1)
    assert flight.autopilot.yaw == pytest.approx(math.pi / 2)
    assert flight.autopilot.rejected == []
    pose = flight.poses[-1]
    north, east, down = flight.autopilot.place
    assert pose.place == pytest.approx((100.0 + east, 50.0 + north), abs=1e-3)
    assert pose.velocity == pytest.approx((4.0, -1.5), abs=1e-5)
    assert pose.height == pytest.approx(-down, abs=1e-3)
    flight.close()


def test_the_mask_lets_velocity_and_yaw_count():
    """Its bits are those of the message's definition."""
    ignored = ("X", "Y", "Z", "AX", "AY", "AZ", "YAW_RATE")
    assert sum(getattr(M, f"POSITION_TARGET_TYPEMASK_{name}_IGNORE") for name in ignored) == MASK


def test_arming_and_modes_stay_the_pilots(flight):
    """The bridge streams in any mode, commands none, and the vehicle moves only where the pilot lets it."""
    flight.velocity = (3.0, 0.0)
    flight.autopilot.armed = False
    flight.pass_time(2.0)
    assert flight.autopilot.velocity == [0.0, 0.0, 0.0]
    flight.autopilot.armed = True
    assert flight.autopilot.pilot_sets_mode("POSCTL")
    flight.pass_time(2.0)
    assert flight.autopilot.velocity == [0.0, 0.0, 0.0]
    assert flight.bridge.mode == Mode("POSCTL", armed=True)
    assert flight.autopilot.pilot_sets_mode("OFFBOARD")
    flight.pass_time(2.0)
    assert flight.autopilot.velocity[1] == pytest.approx(3.0)
    assert set(flight.autopilot.commands) <= {M.MAV_CMD_SET_MESSAGE_INTERVAL}


def test_offboard_needs_the_stream_before():
    """Without a flight node there is none, so the autopilot refuses the pilot's switch."""
    flight = Flight()
    flight.node = False
    flight.pass_time(3.0)
    assert flight.bridge.sent == 0
    assert not flight.autopilot.pilot_sets_mode("OFFBOARD")
    flight.node = True
    flight.pass_time(0.5)
    assert not flight.autopilot.pilot_sets_mode("OFFBOARD")
    flight.pass_time(1.0)
    assert flight.autopilot.pilot_sets_mode("OFFBOARD")
    flight.close()


def test_far_from_the_height_nothing_moves_it():
    """Take-off belongs to the pilot: on the ground, low or high, armed and in Offboard, it neither climbs nor flies."""
    for height in (0.0, 15.0, 22.5):
        flight = Flight(height=height).armed()
        flight.velocity = (5.0, 0.0)
        flight.pass_time(3.0)
        assert flight.autopilot.velocity == [0.0, 0.0, 0.0]
        assert -flight.autopilot.place[2] == pytest.approx(height)
        assert flight.autopilot.mode == "OFFBOARD"
        flight.close()


def test_hover_keeps_the_height():
    """Whether the node or the link commands it, the vehicle stays where it is, though its type flies higher."""
    flight = Flight(height=18.5)
    flight.hovers = True
    flight.armed()
    flight.pass_time(1.0)
    flight.node = False
    flight.pass_time(1.0)
    assert flight.autopilot.mode == "OFFBOARD"
    assert flight.autopilot.place == pytest.approx([0.0, 0.0, -18.5])
    flight.close()


@pytest.mark.parametrize("fault", ["frozen", "mute", "broken"])
def test_without_positions_the_vehicle_keeps_its_height_and_the_stream_ends(fault):
    """A height that is not known any more commands no climb: within a second the autopilot has the vehicle."""
    flight = Flight(height=18.5).armed()
    flight.velocity = (1.0, 0.0)
    flight.pass_time(0.7)
    assert flight.autopilot.velocity[2] < -0.5
    setattr(flight.autopilot, fault, True)
    flight.pass_time(0.9)
    assert flight.autopilot.mode == "OFFBOARD"
    assert flight.autopilot.velocity == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    kept = flight.autopilot.place[2]
    assert kept == pytest.approx(-19.3, abs=0.4)
    flight.pass_time(1.0)
    assert (flight.autopilot.mode, flight.autopilot.failsafes) == ("LOITER", 1)
    flight.pass_time(30.0)
    assert flight.autopilot.place[2] == pytest.approx(kept, abs=0.05)
    flight.close()


def test_only_the_pilot_lets_a_vehicle_fly_again():
    """ArduPilot stays in Guided through a silence; when the node is back, it hovers until the pilot chooses again."""
    flight = Flight("ardupilot").armed("GUIDED")
    flight.velocity = (2.0, 0.0)
    flight.pass_time(2.0)
    assert flight.autopilot.velocity[1] == pytest.approx(2.0)
    flight.node = False
    flight.pass_time(600.0)
    flight.node = True
    flight.pass_time(5.0)
    assert flight.autopilot.mode == "GUIDED"
    assert flight.bridge.sent > 0
    assert flight.autopilot.velocity == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    flight.autopilot.pilot_sets_mode("LOITER")
    flight.pass_time(1.0)
    flight.autopilot.pilot_sets_mode("GUIDED")
    flight.pass_time(1.0)
    assert flight.autopilot.velocity[1] == pytest.approx(2.0)
    flight.close()


def test_a_vehicle_that_is_already_in_guided_waits_for_its_pilot():
    """A node that comes to a vehicle in flight does not take it over without an act of the pilot."""
    flight = Flight("ardupilot")
    flight.node = False
    flight.armed("GUIDED")
    flight.velocity = (2.0, 0.0)
    flight.pass_time(2.0)
    flight.node = True
    flight.pass_time(2.0)
    assert flight.bridge.sent > 0
    assert flight.autopilot.velocity == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    flight.close()


def test_positions_are_as_old_as_on_the_autopilots_clock():
    """A latency that grows is an age; what is older than the newest is refused; a restart begins anew."""
    clock = AutopilotClock()
    assert clock.goes_on(10.0, 100.0)
    assert clock.goes_on(10.1, 100.1)
    assert clock.age == pytest.approx(0.0, abs=1e-3)
    assert clock.goes_on(10.2, 100.9)
    assert clock.age == pytest.approx(0.7, abs=1e-3)
    assert not clock.goes_on(10.15, 100.95)
    assert not clock.goes_on(10.2, 200.0)
    assert not clock.goes_on(0.5, 101.0)
    assert clock.goes_on(0.6, 102.0)
    assert clock.age == pytest.approx(0.0, abs=1e-3)
    for second in range(3600):  # an autopilot whose clock is 50 ppm slow
        assert clock.goes_on(1.6 + second * (1 - 5e-5), 103.0 + second)
    assert clock.age < 2e-3


def test_a_backlog_is_neither_told_as_new_nor_flown_on(flight):
    """After a stall the oldest messages are read first; the pose's stamp is that of their measurement."""
    flight.velocity = (3.0, 0.0)
    flight.pass_time(1.0)
    stalled = flight.clock.now
    for _ in range(16):
        flight.clock.now += PERIOD
        flight.autopilot.turn()
    before, wire = len(flight.poses), flight.way._wire
    flight.way._wire = _Slow(wire, 4)
    flight.bridge.turn()
    flight.way._wire = wire
    flight.autopilot.read()
    assert flight.autopilot.wanted == [0.0, 0.0, 0.0]
    flight.pass_time(PERIOD)
    assert flight.poses[before].stamp / 1e6 == pytest.approx(stalled + 0.1, abs=0.11)


class _Slow:
    """A wire on which only some messages have come."""

    def __init__(self, wire, most):
        self._wire, self._left = wire, most
        self.mav = wire.mav

    def recv_msg(self):
        """Return the next of them."""
        self._left -= 1
        return self._wire.recv_msg() if self._left >= 0 else None


def test_a_wind_that_is_unknown_or_old_is_none(flight):
    """PX4 tells NaN where it does not know; the pose has no wind then, and is told nevertheless."""
    tell = flight.autopilot._wire.mav.wind_cov_send
    tell(0, 1.0, -2.0, 0.0, *[0.0] * 5)
    flight.pass_time(PERIOD)
    assert flight.poses[-1].wind == (-2.0, 1.0)
    flight.pass_time(6.0)
    assert flight.poses[-1].wind == ()
    tell(0, math.nan, math.nan, 0.0, *[0.0] * 5)
    before = len(flight.poses)
    flight.pass_time(0.5)
    assert len(flight.poses) > before
    assert flight.poses[-1].wind == ()


def test_a_node_that_is_silent_stops_the_vehicle_then_the_stream(flight):
    """Hover within the validity, after STOP_SECONDS the autopilot's own failsafe; a node that is back flies nothing."""
    flight.velocity = (3.0, 0.0)
    flight.pass_time(3.0)
    flight.node = False
    flight.pass_time(0.4)
    assert flight.autopilot.velocity[1] == pytest.approx(3.0)
    flight.pass_time(1.0)
    assert flight.autopilot.velocity == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    assert flight.autopilot.mode == "OFFBOARD"
    flight.pass_time(STOP_SECONDS)
    sent = flight.bridge.sent
    assert (flight.autopilot.mode, flight.autopilot.failsafes) == ("LOITER", 1)
    flight.pass_time(2.0)
    assert flight.bridge.sent == sent
    flight.node = True
    flight.pass_time(2.0)
    assert flight.bridge.sent > sent
    assert flight.autopilot.velocity == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    assert flight.link.lapses == 1


def test_a_bridge_that_dies_leaves_the_vehicle_to_the_autopilot(flight):
    """Its stream ends at once, and the autopilot loiters."""
    flight.velocity = (3.0, 0.0)
    flight.pass_time(3.0)
    flight.bridge.close()
    for _ in range(40):
        flight.clock.now += PERIOD
        flight.autopilot.turn()
    assert (flight.autopilot.mode, flight.autopilot.failsafes) == ("LOITER", 1)
    assert flight.autopilot.velocity == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)


def test_poses_that_are_frozen_are_not_told(flight):
    """A position whose time does not go on is none, so the flight node notices."""
    before = len(flight.poses)
    flight.pass_time(1.0)
    assert len(flight.poses) > before
    flight.autopilot.frozen = True
    flight.pass_time(PERIOD)
    before = len(flight.poses)
    flight.pass_time(1.0)
    assert len(flight.poses) == before
    assert flight.bridge.frozen >= 15


def test_ardupilot_is_asked_for_positions_and_flies_in_guided():
    """Its stream of positions begins with the request; Guided stops by itself when set-points end."""
    flight = Flight("ardupilot").armed("GUIDED")
    flight.velocity = (0.0, 2.0)
    flight.pass_time(3.0)
    assert flight.autopilot.velocity[0] == pytest.approx(2.0)
    assert flight.poses
    assert flight.bridge.mode == Mode("GUIDED", armed=True)
    flight.node = False
    flight.pass_time(STOP_SECONDS + 4.0)
    assert flight.autopilot.velocity == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    flight.close()


def test_latitude_and_longitude_are_told_as_they_are():
    """The flight node turns them into metres; MAVLink's degrees are exact to a centimetre."""
    origin = TangentPlane(7.05, 51.02)
    flight = Flight(origin=origin)
    flight.autopilot.place[:2] = [80.0, 120.0]
    flight.pass_time(1.0)
    pose = flight.poses[-1]
    latitude, longitude = pose.place
    metres = origin.to_metres(np.array([[longitude, latitude]]))[0, :2]
    assert pose.geodetic
    np.testing.assert_allclose(metres, (120.0, 80.0), atol=0.02)
    flight.close()


def test_what_is_refused_is_logged_once_a_second(flight, capsys):
    """Set-points that are too fast, with their reason, and positions that stand still; in silence nothing is."""
    flight.velocity = (3.0, 0.0)
    flight.pass_time(2.0)
    assert "refused" not in capsys.readouterr().err
    flight.velocity = (11.0, 0.0)
    flight.pass_time(1.0)
    flight.velocity, flight.autopilot.frozen = (3.0, 0.0), True
    flight.pass_time(2.0)
    told = capsys.readouterr().err
    assert "set-points refused; the last: the set-point is faster than this vehicle may fly." in told
    assert "ran out of validity; the vehicle hovered." in told
    assert "positions of the autopilot are not new" in told


def test_what_another_system_says_is_ignored():
    """Only the vehicle's own system and its autopilot tell where it is."""
    flight = Flight()
    flight.autopilot._wire.mav.srcSystem = 9
    flight.pass_time(1.0)
    assert (flight.poses, flight.bridge.mode) == ([], None)
    flight.autopilot._wire.mav.srcSystem, flight.autopilot._wire.mav.srcComponent = 1, 7
    flight.pass_time(1.0)
    assert (flight.poses, flight.bridge.mode) == ([], None)
    flight.autopilot._wire.mav.srcComponent = 1
    flight.pass_time(1.0)
    assert flight.poses
    assert flight.bridge.mode == Mode("POSCTL", armed=False)
    flight.close()
