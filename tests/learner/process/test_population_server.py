"""The learner applies a round that is due from the coordinator that leads, and refuses all others."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from eia_sec.common.protocol.messages import Envelope, ExploitMessage, ReceiptMessage
from eia_sec.learner.process import population_server
from eia_sec.learner.process.lease import Lease
from eia_sec.learner.process.population_server import PopulationServer
from tests.learner.test_exploit import configured, imitating, kept, learn, trainer_of


def receipt(event, trainer, epoch=5, name="coordinator"):
    """Send one round to a learner; return its receipt, the server, and what was applied."""
    answers, applied, lease = [], [], Lease()
    lease.claim("coordinator", 1, 0.0)
    request = SimpleNamespace(
        payload=ExploitMessage.of(event, epoch).encode(),
        attachment=Envelope("elite", name, 1, 1).encode(),
        reply=answers.append,
    )
    server = PopulationServer(
        SimpleNamespace(waiting=lambda: [request]), trainer, lease, 5, lambda *what: applied.append(what)
    )
    server.answer()
    return ReceiptMessage.decode(answers[0]), server, applied


@pytest.fixture(scope="module")
def started():
    """A trainer that has finished a tenth of its run and more."""
    trainer = trainer_of(replace(configured("ippo"), episodes=10))
    learn(trainer, range(2))
    return trainer


def test_a_due_round_is_applied_once(started):
    """With what was there before, for the history; the second time it is acknowledged as applied before."""
    event = imitating(started, started.actors().flat)
    event = replace(event, hyperparameters={**event.hyperparameters, "actor_rate": 2e-3})
    answer, server, applied = receipt(event, started)
    assert (answer.done, answer.reason) == (True, "")
    ((got, before),) = applied
    assert (got.round, got.sources, got.hyperparameters["actor_rate"]) == (1, ("other", ""), 2e-3)
    assert before["actor_rate"] == 1e-3
    assert server.metrics() == {"round": 1, "hyperparameters": dict(event.hyperparameters), "rounds_refused": 0}
    again, _, applied = receipt(event, started)
    assert (again.done, again.reason, applied) == (True, "applied before", [])


@pytest.mark.parametrize(
    ("number", "options", "said"),
    [
        (10, {}, "round 10 never falls due in this run; the last one is 9"),
        (1, {"epoch": 4}, "another start of the learner"),
        (1, {"name": "other"}, "another coordinator leads"),
    ],
)
def test_other_rounds_are_refused_counted_and_shown(started, number, options, said):
    """The reason is in the receipt and in an alarm."""
    answer, server, applied = receipt(
        replace(imitating(started, started.actors().flat), round=number), started, **options
    )
    assert (answer.done, applied) == (False, [])
    assert said in answer.reason
    assert server.metrics()["rounds_refused"] == 1
    assert server.alarms() == [f"1 rounds of the population were refused; the last one: {answer.reason}"]


def test_rounds_that_nobody_holds_raise_an_alarm(monkeypatch):
    """Once a round is due for a while without a coordinator; one that leads may wait for slower members."""
    trainer, lease, clock = trainer_of(replace(configured("ippo"), episodes=10)), Lease(), [100.0]
    monkeypatch.setattr(population_server, "monotonic", lambda: clock[0])
    server = PopulationServer(SimpleNamespace(waiting=list), trainer, lease, 5, lambda *what: None)

    def alarms(seconds):
        clock[0] += seconds
        return server.alarms()

    assert (alarms(0.0), alarms(60.0)) == ([], [])
    learn(trainer, range(2))
    assert alarms(0.0) == alarms(9.9) == []
    (said,) = alarms(0.2)
    assert said.startswith("round 1 of the population has been due since 10.0% of the run, and no coordinator leads")
    lease.claim("coordinator", 1, clock[0])
    assert alarms(2.9) == alarms(0.2) == alarms(9.9) == []  # the lead is lost once more
    assert alarms(0.2) == [said]
    trainer.exploit(kept(trainer, 2))
    assert alarms(60.0) == []
    assert server.ending() == "; the newest round of the population was 2 of 9"


def test_a_run_alone_takes_part_in_no_round():
    """It reports no round either."""
    trainer = trainer_of(configured("ippo"))
    alone = trainer_of(replace(trainer.config, population=type(trainer.config.population)()))
    answer, server, applied = receipt(imitating(trainer, trainer.actors().flat), alone)
    assert (answer.done, applied, server.metrics(), server.ending()) == (False, [], {}, "")
