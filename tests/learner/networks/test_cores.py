"""Kernels that share their work among processor cores."""

import itertools
import json
import os
import subprocess
import sys

import numpy as np
import pytest

from eia_sec.learner.networks.compiled import shares

UPDATES = """
import json
import sys
from dataclasses import replace

import numba
import torch

from eia_sec.learner.off_policy.engine import Engine
from tests.learner.off_policy.variants import variant
from tests.learner.off_policy.test_engine import BASE, TEAM, batches

cores = int(sys.argv[1])
torch.set_num_threads(cores)
found = {}
for name in ("eia-sec", "maddpg", "masac"):
    config = variant(BASE, name)
    engine = Engine(config, TEAM, 3, dtype=torch.float64)
    for batch in batches(TEAM, config, 20):
        engine.update(batch)
    found[name] = engine.algorithm.actors.networks.flat.detach().tolist()
print(json.dumps({"threads": numba.get_num_threads(), "layer": cores > 1 and numba.threading_layer(), **found}))
"""


@pytest.mark.parametrize(("costs", "cores"), [([5, 3, 3, 2, 2, 1], 2), ([1] * 12, 4), ([7], 3), ([9, 1, 1, 1], 2)])
def test_shares_are_all_of_it_and_about_as_large(costs, cores):
    """Everything has one place, no part is empty, and none exceeds the mean by more than the dearest thing."""
    order, bounds = shares(costs, cores)
    assert sorted(order.tolist()) == list(range(len(costs)))
    assert bounds[0] == 0
    assert bounds[-1] == len(costs)
    assert (np.diff(bounds) > 0).all()
    parts = [sum(costs[thing] for thing in order[a:b]) for a, b in itertools.pairwise(bounds)]
    assert len(parts) == min(cores, len(costs))
    assert max(parts) <= sum(costs) / len(parts) + max(costs)


@pytest.mark.slow
def test_two_cores_train_as_one_does():
    """Twenty updates with threads of their own on two cores end where they end on one."""
    found = []
    for cores in ("1", "2"):
        environment = {**os.environ, "OMP_NUM_THREADS": cores, "NUMBA_NUM_THREADS": cores, "OPENBLAS_NUM_THREADS": "1"}
        command = [sys.executable, "-c", UPDATES, cores]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, timeout=300)
        found.append(json.loads(done.stdout))
    one, two = found
    assert (one["threads"], two["threads"]) == (1, 2)
    assert two["layer"]
    for name in ("eia-sec", "maddpg", "masac"):
        np.testing.assert_allclose(one[name], two[name], rtol=0, atol=1e-12)
