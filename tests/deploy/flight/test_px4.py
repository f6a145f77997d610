"""What the bridge does over PX4's own Zenoh alone: types and their hashes, frames, and what it does not understand."""

import math

import pytest

pytest.importorskip("rosbags")

from eia_sec.common.errors import SchemaError
from eia_sec.common.protocol import keys
from eia_sec.deploy.flight.bridge import Mode
from eia_sec.deploy.flight.px4 import EARTH
from eia_sec.deploy.flight.px4_messages import DEFINITIONS, SLACK, STATUS, MessageType
from tests.deploy.flight import px4_autopilot
from tests.deploy.flight.flights import PERIOD, over_zenoh

ORIGIN = (51.02, 7.05)


@pytest.fixture
def flight():
    """A flight that is armed and in Offboard."""
    found = over_zenoh().armed()
    yield found
    found.close()


def test_keys_hold_the_published_hashes():
    """VehicleStatus's is in PX4's documentation; the others are those of px4_msgs 1.16 to 1.18."""
    kinds = [MessageType.of(name, text) for name, text in DEFINITIONS.items()]
    kinds += [MessageType.of("VehicleStatus", text) for text in STATUS]
    topics = {topic.kind: topic for topic in keys.PX4_TOPICS}
    assert {topics[kind.name].key(kind.type_hash) for kind in kinds} == {
        px4_autopilot.OFFBOARD,
        px4_autopilot.SETPOINT,
        px4_autopilot.POSITION,
        px4_autopilot.STATUS_1_16,
        px4_autopilot.STATUS_1_18,
    }


@pytest.mark.parametrize("status", [px4_autopilot.STATUS_1_16, px4_autopilot.STATUS_1_18])
def test_mode_and_arming_are_read_in_either_version(status):
    """PX4 1.18 tells more in its status than 1.16 and 1.17."""
    flight = over_zenoh(status=status).armed()
    flight.pass_time(PERIOD)
    assert flight.bridge.mode == Mode("OFFBOARD", armed=True)
    assert flight.way.refused == 0
    flight.close()


def test_latitude_and_longitude_are_those_that_px4_has_measured():
    """Projected as PX4 projects, they are the place in its own frame again."""
    flight = over_zenoh(ORIGIN)
    flight.autopilot.place[:2] = [180.0, -240.0]
    flight.pass_time(1.0)
    pose = flight.poses[-1]
    assert pose.geodetic
    latitude, longitude = map(math.radians, pose.place)
    origin, east = map(math.radians, ORIGIN)
    turn = longitude - east
    angle = math.acos(math.sin(origin) * math.sin(latitude) + math.cos(origin) * math.cos(latitude) * math.cos(turn))
    scale = EARTH * angle / math.sin(angle)
    north = math.cos(origin) * math.sin(latitude) - math.sin(origin) * math.cos(latitude) * math.cos(turn)
    place = scale * north, scale * math.cos(latitude) * math.sin(turn)
    assert place == pytest.approx((180.0, -240.0), abs=0.01)
    flight.close()


@pytest.mark.parametrize("lack", ["place", "origin"])
def test_a_place_that_px4_does_not_know_is_not_told(lack, capsys):
    """Neither before its estimator has one, nor in degrees before it knows where its origin lies."""
    flight = over_zenoh(ORIGIN)
    if lack == "place":
        flight.autopilot.valid = False
    else:
        flight.autopilot._origin = None
    flight.pass_time(2.0)
    assert flight.poses == []
    assert flight.bridge.sent == 0
    assert capsys.readouterr().err.count("PX4 does not know its place") == 1
    flight.close()


@pytest.mark.parametrize(
    ("fault", "sentence"),
    [
        ("version", "another version of VehicleLocalPosition than 1.16 to 1.18"),
        ("attachment", "no attachment of rmw_zenoh"),
        ("cut", "is none"),
        ("gid", "another PX4 than the first one"),
    ],
)
def test_what_is_not_understood_is_refused_and_the_vehicle_stops(flight, fault, sentence, capsys):
    """A position of another version, without its attachment, of another length or of another PX4 is none."""
    flight.velocity = (2.0, 0.0)
    flight.pass_time(2.0)
    assert flight.autopilot.velocity[1] == pytest.approx(2.0)
    assert flight.way.refused == 0
    flight.autopilot.fault = fault
    flight.pass_time(1.0)
    assert flight.autopilot.velocity == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    flight.pass_time(1.0)
    assert (flight.autopilot.mode, flight.autopilot.failsafes) == ("LOITER", 1)
    assert flight.way.refused >= 40
    assert capsys.readouterr().err.count(sentence) == 1


def test_a_message_is_decoded_from_its_own_length_alone():
    """What PX4's buffer holds behind it is left out; more than that, or less than the message, is none."""
    kind = MessageType.of("TrajectorySetpoint", DEFINITIONS["TrajectorySetpoint"])
    message = kind.encode(velocity=(1.0, 2.0, 3.0))
    assert len(message) == kind.size
    assert kind.decode(message + bytes(SLACK)).velocity.tolist() == [1.0, 2.0, 3.0]
    for wrong in (message[:-1], message + bytes(SLACK + 1), b"\x00\x00" + message[2:], b""):
        with pytest.raises(SchemaError, match="is none"):
            kind.decode(wrong)
