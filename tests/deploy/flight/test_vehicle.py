"""A vehicle's link: which set-points it obeys, for how long, and what its poses tell."""

import numpy as np
import pytest

from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import Envelope, PoseMessage, SetpointMessage
from eia_sec.deploy.flight.vehicle import RECENT_SECONDS, RELEASE_SECONDS, Pose, VehicleLink
from tests.deploy.flight.air import Air, Clock

RUN, UAV, AGENT = "run", "uav", "monitoring_0"
HERE = Pose((10.0, 20.0), 18.0, (1.0, 0.0))


class Both:
    """A link that may fly 10 m/s along each axis, and the nodes at the other end."""

    def __init__(self):
        self.air, self.clock = Air(), Clock()
        self.link = VehicleLink(self.air, RUN, UAV, AGENT, (10.0, 10.0), self.clock, self.clock)
        self._out = self.air.publish(keys.SETPOINT.key(RUN, vehicle=UAV))
        self._in = self.air.subscribe(keys.POSE.key(RUN, vehicle=UAV), 16)

    def send(self, start, sequence, velocity=(1.0, 2.0), *, name="main", role="flight", **changes):
        """Send a set-point; return whether it is obeyed."""
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
            "stamp": int(self.clock.now * 1e6),
            "latency": 0.0,
        }
        message = SetpointMessage(**{**whole, **changes})
        refused = self.link.refused
        self._out.put(message.encode(), Envelope(role, name, start, sequence).encode())
        found = self.link.setpoint()
        assert found == message or self.link.refused > refused
        return self.link.refused == refused

    def told(self):
        """Publish a pose and return it as the nodes get it."""
        self.link.publish(HERE)
        (sample,) = self._in.drain()
        sender, message = Envelope.decode(sample.attachment), PoseMessage.decode(sample.payload)
        assert (sender.role, sender.name) == ("vehicle", UAV)
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
    assert not both.send(5, 1000, validity=1e6)
    assert both.link.refused == 8
    assert both.send(6, 1)


def test_a_vehicle_hovers_by_itself_when_the_validity_is_over(both):
    """Before the first set-point, and from the end of the last one's validity on; each lapse counts once."""
    assert both.link.setpoint().reason == "no set-point has come yet"
    assert both.send(1, 1, validity=0.5)
    both.clock.now += 0.45
    assert not both.link.setpoint().hover
    both.clock.now += 0.1
    for _ in range(3):
        found = both.link.setpoint()
        assert (found.hover, found.velocity, found.height) == (True, (0.0, 0.0), 20.0)
        assert found.reason == "the last set-point's validity is over"
        both.clock.now += 1.0
    assert both.link.lapses == 1
    assert both.link.silent == pytest.approx(3.55)
    assert both.send(1, 2)


def test_set_points_that_were_held_up_are_not_obeyed(both):
    """A link that was frozen brings old ones at once; by the vehicle's own clock their pose is too old."""
    stamp = int(both.clock.now * 1e6)
    assert both.send(1, 1, stamp=stamp)
    both.clock.now += 2.4
    assert both.send(1, 2, stamp=stamp)
    both.clock.now += 0.2
    assert not both.send(1, 3, stamp=stamp)
    assert both.send(1, 4, (0.0, 0.0), hover=True, stamp=0)


def test_one_node_at_a_time_is_obeyed_and_both_are_told(both):
    """A second node is refused until the first has been silent; poses name the one that is obeyed, and the other."""
    assert (both.told().node, both.told().rival) == ("", "")
    assert both.send(5, 1)
    assert not both.send(9, 1, name="spare")
    found = both.told()
    assert (found.node, found.node_start, found.rival) == ("main", 5, "spare")
    both.clock.now += RELEASE_SECONDS / 2
    assert both.send(5, 2)
    both.clock.now += 0.9 * RELEASE_SECONDS
    assert not both.send(9, 2, name="spare")
    both.clock.now += 0.2 * RELEASE_SECONDS
    assert both.told().node == ""
    assert both.send(9, 3, name="spare")
    assert not both.send(5, 3)
    found = both.told()
    assert (found.node, found.node_start, found.rival) == ("spare", 9, "main")


def test_a_node_whose_clock_was_ahead_gives_way_when_it_is_silent(both):
    """An incarnation that nobody reaches any more is no lock-out: after a silence a lower one is obeyed."""
    assert both.send(2**63 - 1, 1)
    assert not both.send(5, 1)
    both.clock.now += RELEASE_SECONDS
    assert both.send(5, 2)


def test_poses_tell_again_what_was_served_of_late(both):
    """Messages may be lost, so a visit is told for some seconds, with the time at which it was."""
    both.link.serve([7, 3])
    both.clock.now += 1.0
    both.link.serve(np.array([5]))
    found = both.told()
    assert found.served.tolist() == [7, 3, 5]
    assert (found.served_stamp[2] - found.served_stamp[0]) / 1e6 == pytest.approx(1.0)
    assert found.stamp > found.served_stamp.max()
    both.clock.now += RECENT_SECONDS - 0.5
    assert both.told().served.tolist() == [5]
    both.clock.now += 1.0
    assert both.told().served.tolist() == []


def test_poses_tell_the_decision_that_is_flown(both):
    """The number of the newest decision that was obeyed; hover has none."""
    assert both.told().decision == 0
    both.send(1, 4, decision=3)
    assert both.told().decision == 3
    both.send(1, 5, (0.0, 0.0), hover=True, decision=0)
    assert both.told().decision == 3
