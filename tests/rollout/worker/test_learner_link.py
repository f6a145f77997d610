"""A worker follows its learner, and may always be ended while it waits for one."""

import threading
from contextlib import nullcontext
from types import SimpleNamespace

import pytest

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import from_toml, to_toml
from eia_sec.common.errors import UsageError
from eia_sec.common.process import StopSignal
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.epoch_fence import PATIENCE_SECONDS, EpochFence
from eia_sec.common.protocol.messages import ParametersMessage, ProgressMessage
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.rollout.worker import learner_link
from eia_sec.rollout.worker.learner_link import LearnerLink


def test_a_worker_stops_that_waits_for_a_new_learners_configuration():
    """A learner that said that it is new and then answers nobody does not keep its workers from ending.

    They do not follow it either: its configuration may be another one.
    """
    endpoint, stop = free_endpoint(), StopSignal()
    with Bus.listen(endpoint, "control"), Bus.connect(endpoint, "control", 10.0) as bus:
        learner = LearnerLink(bus, "r", "0", RunConfig(), TeamSpec((GroupSpec("one", 2, 3, 2),)), stop)
        learner.epoch = 1
        thread = threading.Thread(target=learner._follow, args=(ProgressMessage(2, 1, 0, 0, 0, 0, "training"),))
        thread.start()
        thread.join(0.5)
        assert thread.is_alive()
        stop.event.set()
        thread.join(60.0)
        assert not thread.is_alive()
        assert (learner.epoch, learner.state) == (1, "unknown")


@pytest.mark.parametrize(
    ("changed", "followed"), [("learner.threads = 2", True), ("evaluation.farms = 9", True), ("seed = 9", False)]
)
def test_a_new_learner_may_change_what_a_resumed_run_may(monkeypatch, changed, followed):
    """Its own threads and the final evaluation are no business of a worker's; another seed is another run."""
    wanted = from_toml(changed, RunConfig())
    assert wanted != RunConfig()
    answer = SimpleNamespace(toml=to_toml(wanted))
    monkeypatch.setattr(learner_link, "fetch_configuration", lambda *arguments: answer)
    learner = LearnerLink(States(), "r", "0", RunConfig(), TeamSpec((GroupSpec("one", 2, 3, 2),)), StopSignal())
    learner.epoch = 1
    follow = nullcontext() if followed else pytest.raises(UsageError, match="another configuration")
    with follow:
        learner._follow(ProgressMessage(2, 1, 0, 0, 0, 0, "training"))
    assert learner.epoch == (2 if followed else 1)


class States:
    """Stands in for a bus: what is put into a subscription's list is polled from it once."""

    def __init__(self):
        self.waiting = {}

    def subscribe_state(self, key):
        queue = self.waiting.setdefault(key, [])
        return SimpleNamespace(poll=lambda: SimpleNamespace(payload=queue.pop(0)) if queue else None, missed=0)


def test_a_learner_whose_clock_was_set_back_is_followed_after_a_while(monkeypatch):
    """Its parameters are dropped with an alarm at first; then the worker takes the ones that it published last."""
    team = TeamSpec((GroupSpec("one", 2, 3, 2),))
    bus, clock = States(), SimpleNamespace(now=0.0)
    monkeypatch.setattr(learner_link, "fetch_configuration", lambda *arguments: None)
    learner = LearnerLink(bus, "r", "0", RunConfig(), team, StopSignal())
    learner._fence = EpochFence(lambda: clock.now)

    def hear(epoch, version, seed):
        actors = TeamActors.initial(team, 4, seed, per_type=False)
        parameters = ParametersMessage(epoch, version, 0, 1, 0.0, team.digest, 4, "deterministic", actors.flat)
        bus.waiting[keys.PARAMETERS.key("r")].append(parameters.encode())
        bus.waiting[keys.PROGRESS.key("r")].append(ProgressMessage(epoch, version, 0, 0, 0, 0, "training").encode())
        learner.poll()
        return actors.digest()

    first = hear(9, 50, 0)
    assert (learner.epoch, learner.store.actors.digest(), learner.alarm) == (9, first, "")
    second = hear(7, 3, 1)
    assert (learner.epoch, learner.store.actors.digest()) == (9, first)
    assert "lower epoch" in learner.alarm
    clock.now = PATIENCE_SECONDS + 1.0
    bus.waiting[keys.PROGRESS.key("r")].append(ProgressMessage(7, 3, 0, 0, 0, 0, "draining").encode())
    learner.poll()
    assert (learner.epoch, learner.state, learner.store.version, learner.alarm) == (7, "draining", 3, "")
    assert learner.store.actors.digest() == second != first
    third = hear(9, 51, 2)
    assert (learner.epoch, learner.store.actors.digest()) == (9, third)
