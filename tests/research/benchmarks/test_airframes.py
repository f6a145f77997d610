"""Farms that simulated vehicles fly: the way from pilot to vehicle changes what is earned by little."""

import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.deploy.monitor.web.hub import Hub
from eia_sec.deploy.monitor.web.source import Source
from research.benchmarks.airframes import RUN, Arguments, fly
from tests.deploy.monitor.web.test_watch_web import kinds


@pytest.mark.parametrize("bridge", ["none", "mavlink"])
def test_vehicles_with_the_farms_dynamics_earn_what_its_simulator_says(bridge):
    """Neither is anything refused on the way, nor does any vehicle hover or stray from its height."""
    if bridge == "mavlink":
        pytest.importorskip("pymavlink")
    found = fly(Arguments(steps=20, airframe="model", bridge=bridge))
    assert found["steps"] == 20
    assert found["flown, by type"] == pytest.approx(found["in the simulator, by type"], abs=3.0)
    assert (found["hovers"], found["left Offboard"], found["set-points that the autopilots refused"]) == (0, 0, 0)
    assert found["height strays, m"] < 0.1


def test_a_watcher_sees_the_flight():
    """`eia-sec watch` finds it where it listens, and shows the farm's map step by step."""
    where, got, hub = free_endpoint(), [], Hub()
    with ThreadPoolExecutor(1) as pool:
        flight = pool.submit(fly, Arguments(steps=60, airframe="model", bridge="none", listen=str(where)))
        with Bus.connect(where, "control", wait=300.0) as watcher:
            seat, source = hub.enter(1), Source(watcher, RUN, None, hub)
            while not flight.done():
                source.tend(True)
                got.extend(kinds(seat))
                time.sleep(0.02)
        assert flight.result()["steps"] == 60
    assert {"scene", "frames"} <= {entry["kind"] for entry in got}
    assert (source.worker, source.malformed) == ("main", 0)
