"""A vehicle's link: which set-points it obeys."""

import time

import numpy as np
import pytest

from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import Envelope, ObservationMessage, SetpointMessage
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.deploy.flight import vehicle
from eia_sec.deploy.flight.vehicle import VehicleLink


@pytest.fixture
def both():
    """A link that may fly 10 m/s along each axis, and what sends it one set-point and returns what it obeyed."""
    endpoint = free_endpoint()
    with Bus.listen(endpoint, "control") as bus, Bus.connect(endpoint, "control") as node:
        link = VehicleLink(bus, "run", "uav", "monitoring_0", (10.0, 10.0))
        publisher = node.publish(keys.SETPOINT.key("run", vehicle="uav"))

        def send(start, sequence, velocity=(1.0, 2.0), *, agent="monitoring_0", hover=False, role="flight"):
            refused, message = link.refused, SetpointMessage(agent, velocity, hover, "", 1, 1, sequence, 0.0)
            deadline = time.monotonic() + 30.0
            found = []
            while not found and link.refused == refused:
                assert time.monotonic() < deadline
                publisher.put(message.encode(), Envelope(role, "main", start, sequence).encode())
                time.sleep(0.02)
                found = link.setpoints()
            return bool(found)

        link.observe(np.zeros(3, np.float32))
        yield send


def test_only_newer_set_points_of_the_own_agent_within_the_speed_are_obeyed(both):
    """What is older, faster, for another agent, or no flight node's is refused and counted."""
    assert both(5, 100)
    assert not both(5, 99)
    assert not both(4, 999)
    assert not both(5, 1000, (11.0, 0.0))
    assert not both(5, 1000, agent="monitoring_1")
    assert not both(5, 1000, (1.0, 0.0), hover=True)
    assert not both(5, 1000, role="rollout")
    assert both(6, 1)


def test_a_node_whose_clock_was_ahead_gives_way_when_it_is_silent(both, monkeypatch):
    """An incarnation that nobody reaches any more is no lock-out: after a silence a lower one is obeyed."""
    assert both(2**63 - 1, 1)
    assert not both(5, 1)
    monkeypatch.setattr(vehicle, "RELEASE_SECONDS", 0.0)
    assert both(5, 2)


def test_a_repeated_observation_keeps_its_number():
    """It is published again as it was, with a newer time stamp; the next observation has the next number."""
    sent, times = [], iter([1.0, 2.5, 4.0])

    class Silent:
        def publish(self, key):
            return self

        def subscribe(self, key, waiting):
            return self

        def put(self, payload, attachment):
            sent.append((ObservationMessage.decode(payload), Envelope.decode(attachment)))

    link = VehicleLink(Silent(), "run", "uav", "monitoring_0", (10.0, 10.0), lambda: next(times))
    values = np.ones(3, np.float32)
    first = link.observe(values)
    values[:] = 7.0
    link.repeat()
    assert link.observe(values) == first + 1
    assert [envelope.sequence for _, envelope in sent] == [first, first, first + 1]
    assert [message.stamp for message, _ in sent] == [1_000_000, 2_500_000, 4_000_000]
    assert [message.values.tolist() for message, _ in sent] == [[1.0] * 3, [1.0] * 3, [7.0] * 3]
