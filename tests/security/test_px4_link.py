"""PX4's link to its bridge, which has no certificate: it leads to nothing but the vehicle, and one PX4 holds it."""

import dataclasses
import time

import pytest

from eia_sec.common.errors import EndpointError
from eia_sec.common.protocol import keys
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import Endpoint, free_endpoint
from eia_sec.common.transport.zenoh_config import connecting
from eia_sec.deploy.flight.bridge import Bridge
from eia_sec.deploy.flight.node import FlightNode, NodeOptions
from eia_sec.deploy.flight.px4 import Px4Autopilot
from eia_sec.deploy.flight.vehicle import VehicleLink
from tests.deploy.flight.air import make_pilot
from tests.deploy.flight.px4_autopilot import FakePx4
from tests.deploy.flight.test_pilot import Constant
from tests.security.probe import open_session
from tests.security.test_flight import AGENT, ALONE, FARM, HERE, RUN, SECONDS, SPEED

HASH = "RIHS01_" + 64 * "0"
TOLD = {topic.key(HASH) for topic in keys.PX4_TOPICS if topic.told}
HEARD = {topic.key(HASH) for topic in keys.PX4_TOPICS if not topic.told}
FOREIGN = {
    keys.POSE.key("run", vehicle="uav"),
    keys.SETPOINT.key("run", vehicle="uav"),
    "0/fmu/in/vehicle_command/px4_msgs::msg::dds_::VehicleCommand_/" + HASH,
    "1/fmu/out/vehicle_status/px4_msgs::msg::dds_::VehicleStatus_/" + HASH,
}


def heard(subscription, wanted) -> set[str]:
    """Return the keys that arrive until all wanted have, and a little longer for what must not."""
    found, deadline, end = set(), time.monotonic() + SECONDS, None
    while end is None or time.monotonic() < end:
        found |= {sample.key for sample in subscription.drain()}
        if end is None and (wanted <= found or time.monotonic() > deadline):
            end = time.monotonic() + 0.5
        time.sleep(0.02)
    return found


def test_whoever_connects_tells_px4s_topics_alone():
    """It sends neither set-points, nor commands, nor poses, in its own name or a vehicle's."""
    where = free_endpoint()
    with Bus.admit_px4(where) as bridge, open_session(connecting(where, "control")) as px4:
        told = bridge.subscribe("**", 1000)
        assert heard(told, set()) == set()
        for key in sorted(TOLD | HEARD | FOREIGN | {"**"}):
            px4.put(key, b"x")
        assert heard(told, TOLD) == TOLD
        assert told.wild == 0


@pytest.mark.parametrize(("asked", "wanted"), [(HEARD | FOREIGN, HEARD), ({"**", "0/fmu/in/*/*/*"}, set())])
def test_whoever_connects_reads_set_points_alone(asked, wanted):
    """Nothing else reaches it, and nothing at all where it asks for more than them."""
    where = free_endpoint()
    with Bus.admit_px4(where) as bridge, Bus.connect(where, "control", wait=SECONDS) as px4:
        publishers = [bridge.publish(key) for key in sorted(HEARD | FOREIGN)]
        subscriptions = [px4.subscribe(key, 1000) for key in sorted(asked)]
        time.sleep(1.0)
        for publisher in publishers:
            publisher.put(b"x")
        found = [heard(each, wanted & {key}) for each, key in zip(subscriptions, sorted(asked), strict=True)]
        assert set().union(*found) == wanted


def test_while_px4_is_connected_nobody_else_is():
    """Who comes later cannot tell another place; when PX4 is gone, it may connect again."""
    where = free_endpoint()
    with Bus.admit_px4(where):
        with Bus.connect(where, "control", wait=SECONDS), pytest.raises(EndpointError):
            Bus.connect(where, "control", wait=2.0)
        with Bus.connect(where, "control", wait=SECONDS):
            pass


def test_with_certificates_a_px4_is_flown_from_node_to_autopilot(keys_folder):
    """The node's set-points reach PX4 over TLS to the bridge of the certificate's vehicle, and PX4's poses the node."""
    pytest.importorskip("rosbags")
    where, link = str(free_endpoint()), free_endpoint()
    config = dataclasses.replace(FARM, world=ALONE)
    pilot = make_pilot(config, Constant(agent_count=3), clock=time.time, names={AGENT: "uav"}, start=1)
    with (
        Bus.listen(Endpoint.parse(where, keys_folder / "flight.main"), "control") as bus,
        Bus.connect(Endpoint.parse(where, keys_folder / "vehicle.uav"), "control", wait=SECONDS) as own,
        Bus.admit_px4(link) as admitted,
        Bus.connect(link, "control", wait=SECONDS) as wire,
    ):
        node = FlightNode(NodeOptions(RUN, "main", 1), pilot, bus)
        others = [VehicleLink(bus, RUN, agent, agent, SPEED) for agent in ("monitoring_0", "collection_0")]
        bridge = Bridge(VehicleLink(own, RUN, "uav", AGENT, SPEED), Px4Autopilot(admitted, HERE.place))
        autopilot = FakePx4(wire, time.monotonic, height=22.0)
        deadline = time.monotonic() + SECONDS
        while autopilot.velocity[1] < 1.0 and time.monotonic() < deadline:
            for part in (autopilot, bridge, node):
                part.turn()
            for other in others:
                other.publish(HERE)
                other.setpoint()
            if autopilot.mode != "OFFBOARD" and autopilot.pilot_sets_mode("OFFBOARD"):
                autopilot.armed = True
            time.sleep(0.02)
        assert autopilot.velocity[1] >= 1.0
        assert autopilot.rejected == []
