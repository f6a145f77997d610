"""The benchmark against autograd: both sides compute the same update."""

import json
import subprocess
import sys

import torch

from eia_sec.common.config import EiaSecConfig
from eia_sec.learner.off_policy.engine import Engine
from research.benchmarks.autograd import AutogradEiaSec, random_batch
from tests.learner.off_policy.test_engine import TEAM


def test_autograd_does_the_engines_update():
    """Five updates by autograd end at the engine's actors, in float64."""
    config = EiaSecConfig(hidden=11, batch=16, ensemble_members=3)
    engine = Engine(config, TEAM, 3, dtype=torch.float64)
    autograd, batch = AutogradEiaSec(engine), random_batch(config, TEAM, torch.float64)
    for _ in range(5):
        engine.update(batch)
        autograd.update(batch)
    method = engine.algorithm
    for kind, network in enumerate(autograd.actors):
        flat = torch.cat([layer.detach().flatten(1) for layer in network], dim=1)
        torch.testing.assert_close(flat, method.actors.networks.export(method.actors.flat, kind), rtol=0, atol=1e-9)


def test_all_three_ways_are_timed():
    """The command prints the times of each for every width."""
    command = [sys.executable, "-m", "research.benchmarks.autograd", "--updates", "4", "--widths", "8", "16"]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300)
    lines = json.loads(done.stdout)["lines"]
    assert [line["width"] for line in lines] == [8, 16]
    assert all(
        line[name]["median_ms"] >= line[name]["ms"] > 0 for line in lines for name in ("compiled", "torch", "autograd")
    )
