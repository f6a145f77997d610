"""The benchmark of several learners measures what it says."""

import pytest

from eia_sec.common.config.files import with_values
from eia_sec.common.config.presets import preset
from research.benchmarks.learners import measure

pytestmark = pytest.mark.research

SMALL = {
    "learner.update_threads": 1,
    "rollout.environments": 2,
    "rollout.chunk_steps": 100,
    "algorithm.iteration_steps": 400,
    "algorithm.minibatch_steps": 100,
}


def test_two_learners_are_measured_beside_one():
    """Every number is there, and the group's time in exchanges is a share of its time."""
    found = measure(with_values(preset("instant"), SMALL), learners=2, repeats=2)
    assert found["learners"] == 2
    assert 0.0 < found["exchange"] < 1.0
    assert found["speed_up_least"] <= found["speed_up"] <= found["speed_up_most"]
    assert min(found["steps_per_second"], found["speed_up"], found["processor"]) > 0.0
