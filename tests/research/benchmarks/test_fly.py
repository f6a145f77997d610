"""The benchmark of flying starts both commands and brings back what they report."""

import json
import subprocess
import sys

from research.benchmarks.peers.catalogue import ROOT


def test_both_sides_are_reported():
    """Every decision that the vehicles waited for is in the node's metrics."""
    command = [sys.executable, "-m", "research.benchmarks.fly", "--rates", "50", "--seconds", "0.4", "--json"]
    done = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True, timeout=300)
    (flown,) = json.loads(done.stdout)["flights"]
    assert (flown["rate"], flown["flight"]["steps"]) == (50.0, 20)
    assert flown["node"]["decisions"] >= 20 * 12
    for spread in (flown["node"]["latency"], flown["flight"]["round_trip_ms"]):
        assert 0.0 < spread["median"] <= spread["p99"] <= spread["most"]
