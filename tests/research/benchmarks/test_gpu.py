"""The benchmark of a learner on a GPU: how it shares out environments, what it refuses, and its page."""

import pytest
import torch

from eia_sec.common.config import RunConfig
from eia_sec.common.errors import UsageError
from research.benchmarks import gpu


@pytest.mark.parametrize(("workers", "each"), [(1, 16), (2, 16), (3, 10), (4, 8), (6, 5), (14, 2), (32, 1), (100, 1)])
def test_chunks_of_all_workers_fit_into_an_iteration(workers, each):
    """Nobody has more environments than by default, and chunks are at most an iteration unless one each is more."""
    config = RunConfig()
    assert gpu.environments(config, workers) == each
    if each > 1:
        assert workers * each * config.rollout.chunk_steps <= config.on_policy.iteration_steps


def test_without_a_gpu_it_says_so(monkeypatch):
    """Without one the user gets one sentence."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(UsageError, match="needs a CUDA device"):
        gpu.machine()
