"""A worker loads the simulator before it connects, unless it flies in somebody else's environment."""

import pytest

from common.errors import EndpointError
from common.transport.endpoint import free_endpoint
from rollout.worker import service
from rollout.worker.service import WorkerOptions, serve
from rollout.worker.warm_up import warm_up


@pytest.mark.parametrize(("env", "wanted"), [(None, ["warm"]), ("toy:env", [])])
def test_the_simulator_is_loaded_for_farms_only(env, wanted, monkeypatch):
    """With --env the worker has no use for it."""
    done = []
    monkeypatch.setattr(service, "warm_up", lambda: done.append("warm"))
    monkeypatch.setattr(service.StopSignal, "install", lambda self: None)
    with pytest.raises(EndpointError):
        serve(WorkerOptions("run", "0", free_endpoint(), patience=0.0, env=env))
    assert done == wanted


def test_everything_that_flies_is_loaded(monkeypatch):
    """It collects a chunk as a worker does."""
    collected = []
    monkeypatch.setattr(
        "rollout.worker.warm_up.Collector.collect", lambda self, *rest, **more: collected.append(self.team)
    )
    warm_up()
    assert [team.agents for team in collected] == [12]
