"""A vehicle's link: which set-points it obeys, for how long, and what its poses tell."""

import dataclasses

import numpy as np
import pytest

from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import Envelope, PoseMessage, SetpointMessage
from eia_sec.deploy.flight.vehicle import MOST_RECENT, RECENT_SECONDS, RELEASE_SECONDS, Pose, VehicleLink
from tests.deploy.flight.air import Air, Clock

RUN, UAV, AGENT = "run", "uav", "monitoring_0"
HERE = Pose((10.0, 20.0), 18.0, (1.0, 0.0))


class Both:
    """A link that may fly 10 m/s along each axis, and the nodes at the other end."""

    def __init__(self):
        self.air, self.clock = Air(), Clock()
        self.monotonic = Clock(0.0)
        self.link = VehicleLink(self.air, RUN, UAV, AGENT, (10.0, 10.0), self.clock, self.monotonic)
        self._out = self.air.publish(keys.SETPOINT.key(RUN, vehicle=UAV))
        self._in = self.air.subscribe(keys.POSE.key(RUN, vehicle=UAV), 16)

    def wait(self, seconds):
        """Let time pass."""
        self.clock.now += seconds
        self.monotonic.now += seconds

    def send(self, start, sequence, velocity=(1.0, 2.0), *, name="main", role="flight", pose=None, **changes):
        """Send a set-point, on a new pose unless on another; return whether it is obeyed."""
        stamp, vehicle_start = pose or self.pose()
        whole = {
            "agent": AGENT,
            "velocity": velocity,
            "target": (),
            "height": 20.0,
            "yaw": 0.0,
            "action": (0.1, 0.2),
            "hover": False,
            "reason": "",
            "decision": sequence,
            "period": sequence,
            "validity": 0.5,
            "stamp": stamp,
            "latency": 0.0,
            "vehicle_start": vehicle_start,
        }
        message = SetpointMessage(**{**whole, **changes})
        refused = self.link.refused
        self._out.put(message.encode(), Envelope(role, name, start, sequence).encode())
        found = self.link.setpoint()
        assert found == message or self.link.refused > refused
        return self.link.refused == refused

    def pose(self):
        """Publish a pose and return what identifies it."""
        return self.told().stamp, self.start

    def told(self, **changes):
        """Publish a pose and return it as the nodes get it."""
        self.link.publish(dataclasses.replace(HERE, **changes))
        (sample,) = self._in.drain()
        sender, message = Envelope.decode(sample.attachment), PoseMessage.decode(sample.payload)
        assert (sender.role, sender.name) == ("vehicle", UAV)
        self.start = sender.incarnation
        return message


@pytest.fixture
def both():
    """A link and its nodes."""
    return Both()


def test_only_newer_set_points_of_the_own_agent_within_the_speed_are_obeyed(both):
    """What is older, faster, for another agent, of no validity, or no flight node's is refused and counted."""
    assert both.send(5, 100)
    assert not both.send(5, 99)
    assert not both.send(4, 999)
    assert not both.send(5, 1000, (11.0, 0.0))
    assert not both.send(5, 1000, agent="monitoring_1")
    assert not both.send(5, 1000, (1.0, 0.0), hover=True)
    assert not both.send(5, 1000, role="rollout")
    assert not both.send(5, 1000, validity=0.0)
    assert not both.send(5, 1000, validity=1.1)
    assert not both.send(5, 1000, height=1.5)
    assert not both.send(5, 1000, height=1e9)
    assert both.link.refused == 10
    assert both.send(5, 1001)


def test_a_vehicle_hovers_by_itself_when_the_validity_is_over(both):
    """Before the first set-point, and from the end of the last one's validity on; each lapse counts once."""
    assert both.link.setpoint().reason == "no set-point has come yet"
    assert both.send(1, 1, validity=0.5)
    both.wait(0.45)
    assert not both.link.setpoint().hover
    both.wait(0.1)
    for _ in range(3):
        found = both.link.setpoint()
        assert (found.hover, found.velocity, found.height) == (True, (0.0, 0.0), 20.0)
        assert found.reason == "the last set-point's validity is over"
        both.wait(1.0)
    assert both.link.lapses == 1
    assert both.link.silent == pytest.approx(3.55)
    assert both.send(1, 2)


def test_set_points_that_were_held_up_are_not_obeyed(both):
    """A link that was frozen brings old ones at once; they are flown until OLDEST_POSE and validity are over."""
    pose = both.pose()
    assert both.send(1, 1, pose=pose)
    both.wait(1.4)
    assert both.send(1, 2, pose=pose)
    both.wait(0.09)
    assert not both.link.setpoint().hover
    both.wait(0.02)
    assert both.link.setpoint().hover
    assert not both.send(1, 3, pose=pose)
    assert both.send(1, 4, (0.0, 0.0), hover=True, pose=(0, 0))


def test_a_pose_is_as_old_as_its_measurement(both):
    """Its stamp and the time for which it is flown on count from when it was measured."""
    fresh, old = both.told().stamp, both.told(age=0.8).stamp
    assert old == fresh + 1  # no stamp goes back
    both.wait(2.0)
    before = both.told().stamp
    both.wait(1.0)
    late = both.told(age=0.8)
    assert late.stamp - before == pytest.approx(2e5, abs=2)
    both.wait(0.6)
    assert both.send(1, 1, pose=(late.stamp, both.start))
    both.wait(0.15)
    assert both.link.setpoint().hover


def test_only_what_answers_a_pose_of_this_very_link_moves_it(both):
    """Not a stamp that it never told, nor another vehicle's of the same name, nor any before it has told one."""
    assert not both.send(1, 1, pose=(1, 1))
    stamp, start = both.pose()
    assert not both.send(1, 2, pose=(stamp + 1, start))
    assert not both.send(1, 3, pose=(stamp, start + 1))
    assert both.link.setpoint().hover
    assert both.send(1, 4, pose=(stamp, start))
    twin = VehicleLink(both.air, RUN, UAV, AGENT, (10.0, 10.0), both.clock, both.monotonic)
    assert both.send(1, 5)
    assert twin.setpoint().hover


def test_a_wall_clock_that_jumps_neither_frees_nor_blocks_old_set_points(both):
    """Ages are by the monotonic clock."""
    pose = both.pose()
    both.clock.now -= 3600.0
    both.monotonic.now += 1.6
    assert not both.send(1, 1, pose=pose)
    both.clock.now += 7200.0
    assert both.send(1, 2, pose=both.pose())


def test_no_message_is_obeyed_twice(both):
    """Also after the node has been silent, and another one was obeyed."""
    pose = both.pose()
    assert both.send(5, 1, (0.0, 0.0), hover=True, pose=pose)
    both.wait(RELEASE_SECONDS)
    assert not both.send(5, 1, (0.0, 0.0), hover=True, pose=pose)
    assert both.link.node == "main"
    assert both.told().node == ""
    assert both.send(9, 1, name="spare")
    both.wait(RELEASE_SECONDS)
    assert not both.send(5, 1, (0.0, 0.0), hover=True, pose=pose)
    assert both.send(5, 2)


def test_a_second_start_of_a_node_waits_as_any_other(both):
    """A node that is started beside its namesake does not take the vehicle away in flight."""
    assert both.send(5, 1)
    assert not both.send(6, 1)
    found = both.told()
    assert (found.node, found.node_start, found.rival) == ("main", 5, "main")
    both.wait(RELEASE_SECONDS)
    assert both.send(6, 2)
    assert both.told().node_start == 6


def test_one_node_at_a_time_is_obeyed_and_both_are_told(both):
    """A second node is refused until the first has been silent; poses name the one that is obeyed, and the other."""
    assert (both.told().node, both.told().rival) == ("", "")
    assert both.send(5, 1)
    assert not both.send(9, 1, name="spare")
    found = both.told()
    assert (found.node, found.node_start, found.rival) == ("main", 5, "spare")
    both.wait(RELEASE_SECONDS / 2)
    assert both.send(5, 2)
    both.wait(0.9 * RELEASE_SECONDS)
    assert not both.send(9, 2, name="spare")
    both.wait(0.2 * RELEASE_SECONDS)
    assert both.told().node == ""
    assert both.send(9, 3, name="spare")
    assert not both.send(5, 3)
    found = both.told()
    assert (found.node, found.node_start, found.rival) == ("spare", 9, "main")


def test_a_node_whose_clock_was_ahead_gives_way_when_it_is_silent(both):
    """An incarnation that nobody reaches any more is no lock-out: after a silence a lower one is obeyed."""
    assert both.send(2**63 - 1, 1)
    assert not both.send(5, 1)
    both.wait(RELEASE_SECONDS)
    assert both.send(5, 2)


def test_poses_tell_again_what_was_served_of_late(both):
    """Messages may be lost, so a visit is told for some seconds, with the time at which it was."""
    both.link.serve([7, 3])
    both.wait(1.0)
    both.link.serve(np.array([5]))
    found = both.told()
    assert found.served.tolist() == [7, 3, 5]
    assert (found.served_stamp[2] - found.served_stamp[0]) / 1e6 == pytest.approx(1.0)
    assert found.stamp >= found.served_stamp.max()
    both.wait(RECENT_SECONDS - 0.5)
    assert both.told().served.tolist() == [5]
    both.wait(1.0)
    assert both.told().served.tolist() == []


def test_too_many_reports_lose_the_oldest_and_are_counted(both):
    """A pose repeats MOST_RECENT of them."""
    both.link.serve(range(MOST_RECENT - 1))
    both.link.serve([5000, 5001, 5002])
    assert both.link.untold == 2
    assert both.told().served.tolist() == [*range(2, MOST_RECENT - 1), 5000, 5001, 5002]


def test_poses_tell_the_decision_that_is_flown(both):
    """The number of the newest decision that was obeyed; hover has none."""
    assert both.told().decision == 0
    both.send(1, 4, decision=3)
    assert both.told().decision == 3
    both.send(1, 5, (0.0, 0.0), hover=True, decision=0)
    assert both.told().decision == 3
