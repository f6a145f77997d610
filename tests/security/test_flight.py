"""Flying with certificates: a vehicle is served, and nobody else can tell its pose or command it."""

import dataclasses
import time

from eia_sec.common.config import FarmConfig
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import Envelope, SetpointMessage
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import Endpoint, free_endpoint
from eia_sec.deploy.flight.node import FlightNode, NodeOptions
from eia_sec.deploy.flight.vehicle import Pose, VehicleLink
from tests.deploy.flight.air import make_pilot
from tests.deploy.flight.test_pilot import Constant

RUN, AGENT, SPEED = "run", "communication_0", (10.0, 10.0)
FARM = FarmConfig()
ALONE = dataclasses.replace(FARM.world, communication_uavs=1, monitoring_uavs=1, collection_uavs=1)
HERE = Pose((50.0, 60.0), 22.0, (0.0, 0.0))
SECONDS = 60.0


def test_a_vehicle_flies_alone_under_its_own_name(keys_folder):
    """The vehicle's own poses are flown on; another vehicle's in its name never arrive, nor do set-points."""
    where = str(free_endpoint())
    clock, start = time.monotonic, 1
    config = dataclasses.replace(FARM, world=ALONE)
    names = {AGENT: "uav", "monitoring_0": "other"}
    pilot = make_pilot(config, Constant(agent_count=3), clock=clock, names=names, only=("uav",), start=start)
    with (
        Bus.listen(Endpoint.parse(where, keys_folder / "flight.main"), "control") as bus,
        Bus.connect(Endpoint.parse(where, keys_folder / "vehicle.uav"), "control", wait=SECONDS) as own,
        Bus.connect(Endpoint.parse(where, keys_folder / "vehicle.other"), "control", wait=SECONDS) as other,
    ):
        node = FlightNode(NodeOptions(RUN, "main", start), pilot, bus)
        mine, second = (
            VehicleLink(own, RUN, "uav", AGENT, SPEED),
            VehicleLink(other, RUN, "other", "monitoring_0", SPEED),
        )
        forged = VehicleLink(other, RUN, "uav", AGENT, SPEED)
        command = other.publish(keys.SETPOINT.key(RUN, vehicle="uav"))
        far = dataclasses.replace(HERE, place=(1e6, 1e6))
        steer = SetpointMessage(
            AGENT, (9.0, 9.0), (), 22.0, 0.0, (0.9, 0.9), False, "", 99, 99, 0.5, 1, 0.0, 1
        ).encode()
        heard = pilot.vehicles
        deadline = time.monotonic() + SECONDS
        while not (heard["uav"].newest and heard["other"].newest) and time.monotonic() < deadline:
            mine.publish(HERE)
            second.publish(HERE)
            node.turn()
            time.sleep(0.05)
        assert heard["uav"].newest is not None
        assert mine.setpoint().hover  # the third one is missing
        assert "collection_0" in mine.setpoint().reason
        own_poses = heard["uav"].newest
        for number in range(20):
            forged.publish(far)
            command.put(steer, Envelope("flight", "x", 2**62, number + 1).encode())
            second.publish(HERE)
            node.turn()
            time.sleep(0.05)
            assert mine.setpoint().velocity == (0.0, 0.0)
        assert heard["other"].newest.stamp > own_poses.stamp  # what it may tell did arrive meanwhile
        assert heard["uav"].newest.place == own_poses.place == HERE.place
        assert pilot.report()["refused"] == 0
        assert (mine.refused, mine.node) == (0, "main")
