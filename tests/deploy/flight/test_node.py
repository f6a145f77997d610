"""A flight node on the bus: it flies beside no living one of its name, and shows watchers its map."""

import time

import numpy as np
import pytest

from eia_sec.common.errors import UsageError
from eia_sec.common.process import Presence
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.deploy.flight.node import FlightNode, NodeOptions, require_absent
from eia_sec.deploy.flight.vehicle import Pose, VehicleLink
from eia_sec.deploy.monitor.web.hub import Hub
from eia_sec.deploy.monitor.web.source import Source
from tests.deploy.flight.air import agents, make_pilot
from tests.deploy.flight.test_pilot import FARM, Constant
from tests.deploy.monitor.web.test_watch_web import kinds

SECONDS = 20.0


def test_a_node_whose_name_lives_is_refused():
    """Another name, another run, and the same name after the first has ended are none of its business."""
    where = free_endpoint()
    with Bus.listen(where, "control"), Bus.connect(where, "control", wait=SECONDS) as bus:
        require_absent(bus, "run", "main")
        with Bus.connect(where, "control", wait=SECONDS) as other:
            first = Presence(other, "run", "flight", "main", 1)
            _until(lambda: not _absent(bus, "main"))
            with pytest.raises(UsageError, match="a flight node main of run run is flying"):
                require_absent(bus, "run", "main")
            require_absent(bus, "run", "spare")
            require_absent(bus, "other", "main")
            assert first is not None
        _until(lambda: _absent(bus, "main"))


def test_a_flight_is_watched_as_a_worker_is():
    """Whoever watches the run sees the map step by step, vehicles where they are, and no rewards."""
    where, got = free_endpoint(), []
    pilot = make_pilot(FARM, Constant(), clock=time.monotonic)
    with (
        Bus.listen(where, "control") as bus,
        Bus.connect(where, "control", wait=SECONDS) as vehicles,
        Bus.connect(where, "control", wait=SECONDS) as watcher,
    ):
        node = FlightNode(NodeOptions("run", "main", 1), pilot, bus)
        links = [VehicleLink(vehicles, "run", name, name, (10.0, 10.0)) for name in agents(FARM)]
        hub = Hub()
        seat, source = hub.enter(1), Source(watcher, "run", None, hub)

        def turn():
            for number, link in enumerate(links):
                link.publish(Pose((50.0 + 20.0 * number, 60.0), 20.0, (0.0, 0.0)))
            node.turn()
            source.tend(True)
            got.extend(kinds(seat))
            return got

        _until(lambda: any(entry["kind"] == "frames" for entry in turn()))
        assert (source.worker, source.malformed, source.lost) == ("main", 0, 0)
    scene = next(entry for entry in got if entry["kind"] == "scene")
    assert (scene["worker"], scene["parts"]) == ("main", [])
    assert pilot.map.farm.position[0, 0] == pytest.approx((50.0, 60.0))
    assert not np.any(pilot.map.farm.parts)


def _absent(bus, name):
    try:
        require_absent(bus, "run", name)
    except UsageError:
        return False
    return True


def _until(true):
    deadline = time.monotonic() + SECONDS
    while not true():
        assert time.monotonic() < deadline
        time.sleep(0.05)
