"""What the bridge does over MAVLink alone, and with ArduPilot."""

import math

import numpy as np
import pytest

from eia_sec.common.errors import EndpointError
from eia_sec.deploy.flight.bridge import STOP_SECONDS, Mode
from eia_sec.deploy.flight.mavlink import MASK
from eia_sec.rollout.farm_files.projection import TangentPlane
from tests.deploy.flight.flights import PERIOD, over_mavlink
from tests.deploy.flight.mavlink_autopilot import M


@pytest.fixture
def flight():
    """A flight with PX4 that is armed and in Offboard."""
    found = over_mavlink().armed()
    yield found
    found.close()


def test_the_mask_lets_velocity_and_yaw_count():
    """Its bits are those of the message's definition."""
    ignored = ("X", "Y", "Z", "AX", "AY", "AZ", "YAW_RATE")
    assert sum(getattr(M, f"POSITION_TARGET_TYPEMASK_{name}_IGNORE") for name in ignored) == MASK


def test_only_the_pilot_lets_a_vehicle_fly_again():
    """ArduPilot stays in Guided through a silence; when the node is back, it hovers until the pilot chooses again."""
    flight = over_mavlink("ardupilot").armed("GUIDED")
    flight.velocity = (2.0, 0.0)
    flight.pass_time(2.0)
    assert flight.autopilot.velocity[1] == pytest.approx(2.0)
    flight.node = ""
    flight.pass_time(600.0)
    flight.node = "main"
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


def test_a_mode_that_changed_while_the_link_was_cut_is_no_go():
    """The stream has not seen the pilot choose Guided, so it hovers until the pilot chooses again."""
    flight = over_mavlink("ardupilot").armed("LOITER")
    flight.velocity = (2.0, 0.0)
    flight.pass_time(2.0)
    turn, flight.autopilot.turn = flight.autopilot.turn, lambda: None
    flight.pass_time(3.0)
    flight.autopilot.pilot_sets_mode("GUIDED")
    flight.autopilot.turn = turn
    flight.autopilot._beat = flight.clock.now
    flight.pass_time(2.0)
    assert flight.bridge.mode == Mode("GUIDED", armed=True)
    assert flight.autopilot.velocity == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    for mode in ("LOITER", "GUIDED"):
        flight.autopilot.pilot_sets_mode(mode)
        flight.pass_time(1.0)
    assert flight.autopilot.velocity[1] == pytest.approx(2.0)
    flight.close()


def test_a_vehicle_that_is_already_in_guided_waits_for_its_pilot():
    """A node that comes to a vehicle in flight does not take it over without an act of the pilot."""
    flight = over_mavlink("ardupilot")
    flight.node = ""
    flight.armed("GUIDED")
    flight.velocity = (2.0, 0.0)
    flight.pass_time(2.0)
    flight.node = "main"
    flight.pass_time(2.0)
    assert flight.bridge.sent > 0
    assert flight.autopilot.velocity == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    flight.close()


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


def test_ardupilot_is_asked_for_positions_and_flies_in_guided():
    """Its stream of positions begins with the request; Guided stops by itself when set-points end."""
    flight = over_mavlink("ardupilot").armed("GUIDED")
    flight.velocity = (0.0, 2.0)
    flight.pass_time(3.0)
    assert flight.autopilot.velocity[0] == pytest.approx(2.0)
    assert flight.poses
    assert flight.bridge.mode == Mode("GUIDED", armed=True)
    flight.node = ""
    flight.pass_time(STOP_SECONDS + 4.0)
    assert flight.autopilot.velocity == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    flight.close()


def test_a_line_that_breaks_is_one_sentence(monkeypatch):
    """A serial line that is unplugged ends the bridge, and the autopilot's time-out acts."""
    flight = over_mavlink().armed()

    def unplugged():
        raise OSError(5, "Input/output error")

    monkeypatch.setattr(flight.way._wire, "recv_msg", unplugged)
    with pytest.raises(EndpointError, match=r"the connection to the autopilot at .* broke: .*Input/output error"):
        flight.pass_time(PERIOD)
    flight.close()


def test_latitude_and_longitude_are_told_as_they_are():
    """The flight node turns them into metres; MAVLink's degrees are exact to a centimetre."""
    origin = TangentPlane(7.05, 51.02)
    flight = over_mavlink(origin=origin)
    flight.autopilot.place[:2] = [80.0, 120.0]
    flight.pass_time(1.0)
    pose = flight.poses[-1]
    latitude, longitude = pose.place
    metres = origin.to_metres(np.array([[longitude, latitude]]))[0, :2]
    assert pose.geodetic
    np.testing.assert_allclose(metres, (120.0, 80.0), atol=0.02)
    flight.close()


def test_what_another_system_says_is_ignored():
    """Only the vehicle's own system and its autopilot tell where it is."""
    flight = over_mavlink()
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
