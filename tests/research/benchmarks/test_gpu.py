"""The benchmark of a learner on a GPU: how it shares out environments, what it refuses, and its page."""

import json

import pytest
import torch

from eia_sec.common.config import RunConfig
from eia_sec.common.errors import UsageError
from research.benchmarks import gpu

RUN = {
    "device": "cuda",
    "environments": 4,
    "workers": 14,
    "steps_per_second": 51234.5,
    "update_ms": 1.234,
    "learner_updating": 0.905,
    "workers_waiting": 0.25,
    "rejected_share": 0.0,
}
DATA = {
    "command": "python -m research.benchmarks.gpu",
    "commit": "abc",
    "packages": {"torch": "2.11.0"},
    "gpu": "a GPU",
    "cores": 16,
    "updates": [{"width": 64, "cpu": 40.04, "cuda": 10.06}],
    "runs": [RUN],
}


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


def test_its_page_says_what_was_measured(tmp_path):
    """Every number is in the tables."""
    gpu.write(DATA, tmp_path)
    page = (tmp_path / "README.md").read_text()
    assert "| 64 | 40.0 | 10.1 |" in page
    assert "| GPU | 14 | 4 | 51,234 | 1.23 | 90% | 25% | 0% |" in page
    assert "`python -m research.benchmarks.gpu`, commit abc, torch 2.11.0, on one a GPU and 16 processor cores" in page
    assert json.loads((tmp_path / "results.json").read_text()) == DATA
