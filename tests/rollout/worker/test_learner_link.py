"""A worker follows its learner, and may always be ended while it waits for one."""

from contextlib import nullcontext
from types import SimpleNamespace

import pytest

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import from_toml, to_toml
from eia_sec.common.errors import UsageError
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.epoch_fence import PATIENCE_SECONDS, EpochFence
from eia_sec.common.protocol.messages import ConfigurationMessage, ParametersMessage, ProgressMessage
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.rollout.worker import learner_link
from eia_sec.rollout.worker.learner_link import LearnerLink


def test_a_worker_goes_on_until_a_new_learner_has_sent_its_configuration():
    """A learner that said that it is new and then answers nobody does not hold its workers, and is not followed yet.

    Its configuration may be another one.
    """
    team, asked = TeamSpec((GroupSpec("one", 2, 3, 2),)), []
    bus = States(lambda: asked.append(1))
    learner = LearnerLink(bus, "r", "0", RunConfig(), team)
    learner.epoch = 1
    for version in (1, 2, 3):
        bus.say(ProgressMessage(2, version, 0, 0, 0, 0, "training"))
        learner.poll()
    assert (learner.epoch, len(asked)) == (1, 1)
    bus.say(ProgressMessage(1, 9, 0, 0, 0, 0, "draining"))
    learner.poll()
    assert (learner.epoch, learner.state) == (1, "draining")
    bus.answer = ConfigurationMessage(2, to_toml(RunConfig()), team.to_dict(), False).encode()
    learner.poll()
    assert (learner.epoch, learner.state, learner.newest_version) == (2, "training", 3)


@pytest.mark.parametrize(
    ("changed", "followed"), [("learner.threads = 2", True), ("evaluation.farms = 9", True), ("seed = 9", False)]
)
def test_a_new_learner_may_change_what_a_resumed_run_may(changed, followed):
    """Its own threads and the final evaluation are no business of a worker's; another seed is another run."""
    wanted = from_toml(changed, RunConfig())
    assert wanted != RunConfig()
    team, bus = TeamSpec((GroupSpec("one", 2, 3, 2),)), States()
    bus.answer = ConfigurationMessage(2, to_toml(wanted), team.to_dict(), False).encode()
    learner = LearnerLink(bus, "r", "0", RunConfig(), team)
    learner.epoch = 1
    bus.say(ProgressMessage(2, 1, 0, 0, 0, 0, "training"))
    with nullcontext() if followed else pytest.raises(UsageError, match="another configuration"):
        learner.poll()
    assert learner.epoch == (2 if followed else 1)


class States:
    """Stands in for a bus: what is put into a subscription's list is polled from it once, and one answer is given."""

    def __init__(self, on_request=lambda: None):
        self.waiting, self.answer, self._on_request = {}, None, on_request

    def say(self, progress):
        self.waiting[keys.PROGRESS.key("r")].append(progress.encode())

    def asking(self, key, payload, timeout):
        self._on_request()
        while self.answer is None:
            yield 0.1
        return self.answer

    def subscribe_state(self, key, capacity=1):
        queue = self.waiting.setdefault(key, [])

        def poll():
            del queue[:-capacity]
            return SimpleNamespace(payload=queue.pop(0)) if queue else None

        return SimpleNamespace(poll=poll, drain=lambda: iter(poll, None), missed=0)


def test_a_learner_whose_clock_was_set_back_is_followed_after_a_while():
    """Its parameters are dropped with an alarm at first; then the worker takes the ones that it published last."""
    team = TeamSpec((GroupSpec("one", 2, 3, 2),))
    bus, clock = States(), SimpleNamespace(now=0.0)
    bus.answer = ConfigurationMessage(7, to_toml(RunConfig()), team.to_dict(), False).encode()
    learner = LearnerLink(bus, "r", "0", RunConfig(), team)
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


def test_parameters_that_do_not_come_are_asked_for_again(monkeypatch, capsys):
    """A replaced learner's may have taken their place, and the learner may wait for this worker; pauses grow."""
    clock = SimpleNamespace(now=0.0)
    monkeypatch.setattr(learner_link, "monotonic", lambda: clock.now)
    team, bus, asked = TeamSpec((GroupSpec("one", 2, 3, 2),)), States(), []
    subscribe = bus.subscribe_state
    bus.subscribe_state = lambda key, *more: asked.append((clock.now, key)) or subscribe(key, *more)
    learner = LearnerLink(bus, "r", "0", RunConfig(), team)
    asked.clear()
    actors = TeamActors.initial(team, 4, 0, per_type=False)

    def comes(version):
        message = ParametersMessage(1, version, 0, 1, 0.0, team.digest, 4, "deterministic", actors.flat)
        bus.waiting[keys.PARAMETERS.key("r")].append(message.encode())

    bus.say(ProgressMessage(1, 2, 0, 0, 0, 0, "training"))
    comes(1)
    for clock.now in range(30):
        learner.poll()
    assert asked == [(6, keys.PARAMETERS.key("r")), (17, keys.PARAMETERS.key("r"))]
    assert capsys.readouterr().err.count("worker 0 asks again for version 2, which has not come.") == 2
    comes(2)
    learner.poll()
    bus.say(ProgressMessage(1, 3, 0, 0, 0, 0, "training"))
    for clock.now in range(30, 37):
        learner.poll()
    assert [at for at, _ in asked] == [6, 17, 35]


def test_a_replaced_learner_does_not_hide_that_its_successor_sends_too():
    """However seldom a worker looks, and whoever has sent last: a chunk may take longer than the fence's patience."""
    team, bus, clock = TeamSpec((GroupSpec("one", 2, 3, 2),)), States(), SimpleNamespace(now=0.0)
    learner = LearnerLink(bus, "r", "0", RunConfig(), team)
    learner._fence = EpochFence(lambda: clock.now)
    bus.say(ProgressMessage(9, 1, 0, 0, 0, 0, "training"))
    learner.poll()
    for clock.now in range(0, 200, 20):
        bus.say(ProgressMessage(9, 1, 0, 0, 0, 0, "training"))
        bus.say(ProgressMessage(7, 5, 0, 0, 0, 0, "training"))
        learner.poll()
        assert learner.epoch == 9
