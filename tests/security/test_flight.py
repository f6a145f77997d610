"""Flying with certificates: a vehicle is served, and nobody else can observe or command in its name."""

import time

import numpy as np

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import FarmConfig
from eia_sec.common.farm import farm_team
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import Envelope, SetpointMessage
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import Endpoint, free_endpoint
from eia_sec.deploy.flight.node import FlightNode, NodeOptions
from eia_sec.deploy.flight.pilot import Limits, Pilot
from eia_sec.deploy.flight.vehicle import VehicleLink

RUN, AGENT, SPEED = "run", "communication_0", (10.0, 10.0)
TEAM = farm_team(FarmConfig())
SEEN = np.ones(TEAM.groups[0].observation_size, np.float32)
SECONDS = 30.0


def test_a_vehicle_flies_alone_under_its_own_name(keys_folder):
    """The vehicle's own observations are decided on; another vehicle's in its name never arrive, nor do set-points."""
    where = str(free_endpoint())
    pilot = Pilot(TeamActors.initial(TEAM, 8, 0), {"uav": AGENT}, SPEED, Limits())
    with (
        Bus.listen(Endpoint.parse(where, keys_folder / "flight.main"), "control") as bus,
        Bus.connect(Endpoint.parse(where, keys_folder / "vehicle.uav"), "control", wait=SECONDS) as own,
        Bus.connect(Endpoint.parse(where, keys_folder / "vehicle.other"), "control", wait=SECONDS) as other,
    ):
        node = FlightNode(NodeOptions(RUN), pilot, ("uav",), bus)
        mine = VehicleLink(own, RUN, "uav", AGENT, SPEED)
        forged = VehicleLink(other, RUN, "uav", AGENT, SPEED)
        command = other.publish(keys.SETPOINT.key(RUN, vehicle="uav"))
        steer = SetpointMessage(AGENT, (10.0, 10.0), False, "", 1, 1, 1, 0.0).encode()
        deadline = time.monotonic() + SECONDS
        found: list[SetpointMessage] = []
        while not any(not message.hover for message in found) and time.monotonic() < deadline:
            mine.observe(SEEN)
            node.turn()
            found += mine.setpoints()
            time.sleep(0.05)
        assert any(not message.hover for message in found)
        idle = 0
        while idle < 10 and time.monotonic() < deadline:  # until none of its own is under way
            decided = pilot.decisions
            node.turn()
            time.sleep(0.2)
            found += mine.setpoints()
            idle = idle + 1 if found[-1].hover and pilot.decisions == decided else 0
        assert found[-1].hover
        before = pilot.decisions
        for number in range(20):
            forged.observe(SEEN)
            command.put(steer, Envelope("flight", "x", 2**62, number + 1).encode())
            node.turn()
            time.sleep(0.05)
        assert (pilot.decisions, pilot.report()["refused"]) == (before, 0)
        assert all(message.hover for message in mine.setpoints())
        assert mine.refused == 0
        # What it sees is what it put itself, which never left its process.
        assert {message.velocity for message in forged.setpoints()} <= {(10.0, 10.0)}
