"""A worker loads the simulator before it connects, unless it flies in somebody else's environment."""

import pytest

from eia_sec.common.errors import EndpointError
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.rollout.worker import service
from eia_sec.rollout.worker.collector import Collector
from eia_sec.rollout.worker.service import WorkerOptions, serve
from eia_sec.rollout.worker.warm_up import warm_up


@pytest.mark.parametrize(("env", "wanted"), [(None, ["warm"]), ("toy:env", [])])
def test_the_simulator_is_loaded_for_farms_only(env, wanted, monkeypatch):
    """With --env the worker has no use for it."""
    done = []
    monkeypatch.setattr(service, "warm_up", lambda: done.append("warm"))
    monkeypatch.setattr(service.StopSignal, "install", lambda self: None)
    with pytest.raises(EndpointError):
        serve(WorkerOptions("run", "0", free_endpoint(), patience=0.0, env=env))
    assert done == wanted


def test_a_worker_that_is_stopped_while_it_loads_does_not_connect(monkeypatch):
    """It ends as one that was stopped, and not as one that found no learner."""
    monkeypatch.setattr(service, "warm_up", lambda: None)
    monkeypatch.setattr(service.StopSignal, "install", lambda self: self.event.set())
    assert serve(WorkerOptions("run", "0", free_endpoint(), patience=0.0)) is None


def test_everything_that_flies_is_loaded(monkeypatch):
    """It collects one step as a worker does, of a farm with all UAVs."""
    chunks = []

    def collect(self, *rest, **more):
        chunks.append(collected(self, *rest, **more))
        return chunks[-1]

    collected = Collector.collect
    monkeypatch.setattr(Collector, "collect", collect)
    warm_up()
    assert [(chunk.rows.steps, chunk.rows.reward.shape[1]) for chunk in chunks] == [(1, 12)]
