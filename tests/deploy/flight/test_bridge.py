"""What every bridge does, against autopilots that keep the protocols' rules: MAVLink over UDP, and PX4's own Zenoh."""

import math

import pytest

from eia_sec.deploy.flight.bridge import CLIMB, STOP_SECONDS, AutopilotClock, Mode
from tests.deploy.flight.flights import CORNER, PERIOD, over_mavlink, over_zenoh


@pytest.fixture(params=["mavlink", "px4"])
def begin(request):
    """What begins a flight."""
    pytest.importorskip({"mavlink": "pymavlink", "px4": "rosbags"}[request.param])
    flights = []

    def make(height=20.0):
        flights.append({"mavlink": over_mavlink, "px4": over_zenoh}[request.param](height=height))
        return flights[-1]

    yield make
    for flight in flights:
        flight.close()


@pytest.fixture
def flight(begin):
    """A flight with PX4 that is armed and in Offboard."""
    return begin().armed()


def test_velocities_fly_east_and_north_at_the_height_of_the_type(begin):
    """The field's x is east and y is north, the height is reached and held, and the nose points east."""
    flight = begin(height=18.1).armed()
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
    assert pose.place == pytest.approx((CORNER[0] + east, CORNER[1] + north), abs=1e-3)
    assert pose.velocity == pytest.approx((4.0, -1.5), abs=1e-5)
    assert pose.height == pytest.approx(-down, abs=1e-3)


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
    assert flight.autopilot.commands == []


def test_offboard_needs_the_stream_before(begin):
    """Without a flight node there is none, so the autopilot refuses the pilot's switch."""
    flight = begin()
    flight.node = ""
    flight.pass_time(3.0)
    assert flight.bridge.sent == 0
    assert not flight.autopilot.pilot_sets_mode("OFFBOARD")
    flight.node = "main"
    flight.pass_time(0.5)
    assert not flight.autopilot.pilot_sets_mode("OFFBOARD")
    flight.pass_time(1.0)
    assert flight.autopilot.pilot_sets_mode("OFFBOARD")


def test_far_from_the_height_nothing_moves_it(begin):
    """Take-off belongs to the pilot: on the ground, low or high, armed and in Offboard, it neither climbs nor flies."""
    for height in (0.0, 15.0, 22.5):
        flight = begin(height=height).armed()
        flight.velocity = (5.0, 0.0)
        flight.pass_time(3.0)
        assert flight.autopilot.velocity == [0.0, 0.0, 0.0]
        assert -flight.autopilot.place[2] == pytest.approx(height)
        assert flight.autopilot.mode == "OFFBOARD"


def test_hover_keeps_the_height(begin):
    """Whether the node or the link commands it, the vehicle stays where it is, though its type flies higher."""
    flight = begin(height=18.5)
    flight.hovers = True
    flight.armed()
    flight.pass_time(1.0)
    flight.node = ""
    flight.pass_time(1.0)
    assert flight.autopilot.mode == "OFFBOARD"
    assert flight.autopilot.place == pytest.approx([0.0, 0.0, -18.5])


@pytest.mark.parametrize("fault", ["frozen", "mute", "broken"])
def test_without_positions_the_vehicle_keeps_its_height_and_the_stream_ends(begin, fault):
    """A height that is not known any more commands no climb: within a second the autopilot has the vehicle."""
    flight = begin(height=18.5).armed()
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


def test_a_node_that_is_silent_stops_the_vehicle_then_the_stream(flight):
    """Hover within the validity, after STOP_SECONDS the autopilot's own failsafe; a node that is back flies nothing."""
    flight.velocity = (3.0, 0.0)
    flight.pass_time(3.0)
    flight.node = ""
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
    flight.node = "main"
    flight.pass_time(2.0)
    assert flight.bridge.sent > sent
    assert flight.autopilot.mode == "OFFBOARD"  # by itself, as PX4 does
    assert flight.autopilot.velocity == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    assert flight.link.lapses == 1


def test_a_bridge_that_dies_leaves_the_vehicle_to_the_autopilot(flight):
    """Its stream ends at once, and the autopilot loiters."""
    flight.velocity = (3.0, 0.0)
    flight.pass_time(3.0)
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
    assert clock.goes_on(0.7, 105.0)
    assert clock.age == pytest.approx(2.9, abs=1e-2)
    assert clock.goes_on(5.0, 300.0)  # it was off for minutes, and now runs for longer than before
    assert clock.age == pytest.approx(0.0, abs=1e-3)
    assert clock.goes_on(5.1, 300.1)
    for second in range(3600):  # an autopilot whose clock is 50 ppm slow
        assert clock.goes_on(6.1 + second * (1 - 5e-5), 301.1 + second)
    assert clock.age < 2e-3


def test_two_nodes_do_not_fly_one_vehicle(begin):
    """It obeys the first. When that dies the second may take over, and the vehicle hovers until its pilot's go."""
    flight = begin().armed()
    flight.velocity = (2.0, 0.0)
    flight.pass_time(2.0)
    for _ in range(20):
        flight.command("spare", (0.0, 3.0))
        flight.pass_time(PERIOD)
    assert flight.autopilot.velocity[:2] == pytest.approx([0.0, 2.0])
    assert flight.link.refused >= 20
    flight.node, flight.velocity = "spare", (0.0, 3.0)
    flight.pass_time(1.0)
    assert flight.autopilot.velocity == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    flight.pass_time(4.0)
    assert flight.link.node == "spare"
    assert flight.autopilot.velocity == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    assert flight.autopilot.pilot_sets_mode("POSCTL")
    flight.pass_time(0.5)
    assert flight.autopilot.pilot_sets_mode("OFFBOARD")
    flight.pass_time(2.0)
    assert flight.autopilot.velocity[:2] == pytest.approx([3.0, 0.0])
