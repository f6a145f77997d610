"""The benchmark of the compiled kernels."""

import json
import subprocess
import sys


def test_both_ways_are_timed():
    """The command prints the times of each for every algorithm and width."""
    command = [sys.executable, "-m", "research.benchmarks.kernels", "--updates", "4", "--widths", "8", "16"]
    command += ["--algorithms", "eia-sec"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300)
    lines = json.loads(done.stdout)["lines"]
    assert [(line["algorithm"], line["width"]) for line in lines] == [("eia-sec", 8), ("eia-sec", 16)]
    assert all(line[name]["median_ms"] >= line[name]["ms"] > 0 for line in lines for name in ("kernels", "torch"))
