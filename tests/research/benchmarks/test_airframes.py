"""Farms that simulated vehicles fly: the way from pilot to vehicle changes what is earned by little."""

import pytest

from research.benchmarks.airframes import Arguments, fly


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
