"""What a worker does from its stop to its end."""

import math
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from eia_sec.common.actors import TeamActors
from eia_sec.common.config import FarmConfig, IppoConfig, RolloutConfig, RunConfig
from eia_sec.common.config.farm import WorldConfig
from eia_sec.common.errors import BusError
from eia_sec.common.farm import farm_team
from eia_sec.common.history.history import History, Start
from eia_sec.common.loops import run
from eia_sec.common.policy_store import PolicyStore
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.codec import NO_LIMIT
from eia_sec.common.protocol.messages import EvaluationOrder, EvaluationResult, ParametersMessage
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.deploy.monitor.audit import audit
from eia_sec.rollout.worker import service
from eia_sec.rollout.worker.collection_gate import CollectionGate
from eia_sec.rollout.worker.evaluation_service import EvaluationService
from eia_sec.rollout.worker.sender import Sender
from eia_sec.rollout.worker.service import Worker, WorkerOptions


class Recorded:
    """Stands for every part of a worker; writes down who was called, and a sender waits as the real one does."""

    def __init__(self, name: str, calls: list[str]) -> None:
        self._name, self._calls = name, calls
        self.in_flight, self.left_behind = 12, 0

    def wait_empty(self, timeout, meanwhile):
        """Two turns of waiting in which nothing is delivered."""
        self._calls.append(f"wait {timeout:.0f}")
        for _ in range(2):
            meanwhile()
            yield 0.0
        return False

    def __getattr__(self, method):
        return lambda *_: self._calls.append(f"{self._name}.{method}")


def an_ending_worker(monkeypatch, state, stop):
    """Return a worker in the state of its run, and the calls of its parts."""
    calls: list[str] = []
    worker = Worker.__new__(Worker)
    worker._options, worker._stop, worker._times = WorkerOptions("run", "3", None), stop, service._Times()
    for name, part in (("_learner", "learner"), ("_evaluations", "evaluations"), ("sender", "sender")):
        setattr(worker, name, Recorded(part, calls))
    worker._learner.state = state
    worker._collector = SimpleNamespace(environment_steps=24)
    monkeypatch.setattr(worker, "_report", lambda: calls.append("report"))
    return worker, calls


@pytest.mark.parametrize(("state", "stop"), [("training", True), ("draining", True), ("finished", False)])
def test_a_worker_that_ends_serves_the_coordinator_while_the_learner_trains(monkeypatch, capsys, state, stop):
    """A learner that waits for an imitation event takes no chunks, so the worker's last ones would wait for itself."""
    worker, calls = an_ending_worker(monkeypatch, state, stop)
    run(worker.run())
    served = ["learner.poll", "evaluations.poll"] * 2 if state == "training" else []
    assert calls == ["wait 5", *served, "report"]
    assert "worker 3: 12 steps were not delivered." in "".join(capsys.readouterr())


def test_the_time_to_end_counts_from_when_the_stop_is_noticed(monkeypatch):
    """An evaluation that goes on then takes its time from the deliveries', and leaves some for them."""
    clock = SimpleNamespace(now=100.0)
    monkeypatch.setattr(service, "monotonic", lambda: clock.now)
    worker, calls = an_ending_worker(monkeypatch, "training", False)
    assert worker._seconds_left() == math.inf
    worker._stop = True
    assert worker._seconds_left() == service.DRAIN_SECONDS
    assert not worker._late_for_evaluations()
    clock.now += 3.0
    assert worker._seconds_left() == service.DRAIN_SECONDS - 3.0
    calls.clear()
    run(worker.run())
    assert calls[0] == "wait 2"
    clock.now += 1.5
    assert not worker._late_for_evaluations()
    clock.now += 1.0
    assert worker._late_for_evaluations()
    calls.clear()
    run(worker.run())
    assert calls[0] == f"wait {service.DELIVER_SECONDS:.0f}"


def a_collecting_worker(monkeypatch, cuts):
    """Return a worker whose chunks take 100 steps of 0.25 s, the steps that it made, and the calls of its parts."""
    clock, steps = SimpleNamespace(now=100.0), []
    monkeypatch.setattr(service, "monotonic", lambda: clock.now)
    worker, calls = an_ending_worker(monkeypatch, "training", False)
    worker._times.reported = clock.now
    worker._learner.store, worker._learner.arguments = SimpleNamespace(version=1), ""
    worker._config, worker._arguments = RunConfig(), RunConfig().env.arguments
    worker._gate = SimpleNamespace(asked_steps=NO_LIMIT)
    worker._view_service, worker._acting = Recorded("view_service", calls), (1, 0.0, False)
    worker._whole = "" if cuts else "chunks are whole"
    monkeypatch.setattr(worker, "_exploration", lambda: (0.0, False))
    worker._collector = SimpleNamespace(simulated=0, environment_steps=0, chunk_steps=1600)

    def collect(actors, noise_std, uniform, goes_on):
        for step in range(100):
            clock.now += 0.25
            steps.append(step)
            worker._collector.simulated += 16
            if step == worker.stops_at:
                worker._stop = True
            if step == worker.drains_at:
                worker._learner.state = "draining"
            if not goes_on():
                break
        worker._collector.environment_steps = 16 * len(steps)
        return SimpleNamespace(rows=SimpleNamespace(steps=16 * len(steps)))

    worker._collector.collect, worker.stops_at, worker.drains_at = collect, -1, -1
    return worker, steps, calls


@pytest.mark.parametrize("event", ["stops_at", "drains_at"])
def test_a_worker_that_ends_delivers_the_chunk_in_progress(monkeypatch, event):
    """The chunk ends with the step in which the worker learns that it should end, and is offered as it is."""
    worker, steps, calls = a_collecting_worker(monkeypatch, cuts=True)
    setattr(worker, event, 50)
    worker._collect(None)
    assert len(steps) == 51
    assert "sender.offer" in calls


@pytest.mark.parametrize(("asked", "steps_made"), [(16 * 40, 40), (16 * 40 - 5, 40), (1, 1), (16 * 1000, 100)])
@pytest.mark.parametrize("newest", ["answer", "progress"])
def test_a_chunk_ends_with_the_steps_that_the_learner_asks_for(monkeypatch, newest, asked, steps_made):
    """The newest word counts, with which a chunk in progress may end; no chunk is longer than configured."""
    worker, steps, calls = a_collecting_worker(monkeypatch, cuts=True)
    told, other = SimpleNamespace(asked_steps=asked), SimpleNamespace(asked_steps=1)
    told.heard_at = told.answered_at = 2.0
    other.heard_at = other.answered_at = 1.0
    sender, learner = (told, other) if newest == "answer" else (other, told)
    worker._gate = CollectionGate(RolloutConfig(), learner, sender, lockstep=False)
    worker._collect(None)
    assert len(steps) == steps_made
    assert "sender.offer" in calls


def test_a_worker_whose_chunks_must_be_whole_leaves_one_that_takes_too_long(monkeypatch):
    """It goes on for three seconds after the stop, so that two are left for deliveries, and leaves the chunk behind."""
    worker, steps, calls = a_collecting_worker(monkeypatch, cuts=False)
    worker.stops_at = 50
    worker._collect(None)
    assert len(steps) == 50 + 1 + 12
    assert "sender.leave_behind" in calls
    assert "sender.offer" not in calls
    monkeypatch.setattr(service, "DRAIN_SECONDS", 60.0)
    steps.clear()
    worker._stop, worker._times.ending = False, 0.0
    worker._collect(None)
    assert "sender.offer" in calls


@pytest.mark.parametrize(
    ("lockstep", "memory", "reason"),
    [
        (True, "none", ", 24 of them because a lockstep run repeats whole chunks"),
        (False, "gru", ", 24 of them because networks with memory learn from chunks of equal length"),
        (False, "none", None),
    ],
)
def test_what_is_left_behind_is_said_with_its_reason(monkeypatch, capsys, lockstep, memory, reason):
    """A run that takes short chunks has nothing to leave behind; each other one names its reason."""
    worker, _ = an_ending_worker(monkeypatch, "training", True)
    config = RunConfig() if memory == "none" else replace(RunConfig(), algorithm=IppoConfig(memory=memory))
    worker._whole = service._why_whole(config, lockstep=lockstep)
    assert bool(worker._whole) == (reason is not None)
    worker.sender.left_behind = 24 if reason else 0
    worker.sender.in_flight = 36
    run(worker.run())
    assert f"worker 3: 36 steps were not delivered{reason or ''}." in "".join(capsys.readouterr())


def test_an_audit_counts_what_was_left_behind_as_lost(tmp_path):
    """The worker's history names the chunk that it never offered, so that nothing ends in silence."""
    learner = History(tmp_path / "history" / "learner.jsonl")
    learner.add(Start("learner", "learner", 1))
    history = History(tmp_path / "history" / "rollout-0.jsonl")
    history.add(Start("rollout", "0", 1))
    rules = SimpleNamespace(spool_chunks=1)
    sender = Sender(SimpleNamespace(close=int), "r", "0", 1, None, rules, 1.0, history)
    sender.flown = 24
    sender.leave_behind(24)
    assert (sender.in_flight, sender.left_behind, sender.spooled) == (24, 24, 0)
    learner.close()
    history.close()
    found = audit(tmp_path)
    assert found.clean, found.named()
    assert (found.steps["lost"], found.lost_with["worker"]) == (24, 24)


def answered(bus, evaluations, order):
    """Return the answer to an order, with the service polled meanwhile."""
    with ThreadPoolExecutor(1) as pool:
        asked = pool.submit(bus.ask, keys.EVALUATION.key("r", worker="0"), order.encode(), 60.0)
        while not asked.done():
            evaluations.poll()
            time.sleep(0.01)
        return asked.result()


def test_an_evaluation_is_given_up_when_the_time_is_over():
    """The coordinator is refused at once, and asks another worker."""
    farm = FarmConfig(world=WorldConfig(1, 1, 1, sensors=12, plots_x=4, plots_y=4, steps=6))
    config, team = RunConfig(farm=farm), farm_team(farm)
    store = PolicyStore(team)
    actors = TeamActors.initial(team, 4, 0)
    store.offer_parameters(ParametersMessage(1, 1, 0, 1, 0.0, team.digest, 4, actors.head, actors.flat))
    asked: list[int] = []
    cancelled = SimpleNamespace(after=100)

    def over():
        asked.append(1)
        return len(asked) > cancelled.after

    endpoint = free_endpoint()
    with Bus.listen(endpoint, "control") as here, Bus.connect(endpoint, "control", 10.0) as there:
        evaluations = EvaluationService(here, config, "r", "0", store, over)
        order = EvaluationOrder(1, 1, 1, (3,), (4,))
        result = answered(there, evaluations, order)
        assert EvaluationResult.decode(result).reward.shape == (1, 6, 3)
        assert len(asked) == 6
        cancelled.after = 8
        with pytest.raises(BusError, match="given up"):
            answered(there, evaluations, order)
        assert len(asked) == 9


def test_an_order_with_actors_is_answered_with_those():
    """Whatever the worker itself has by then; those that do not fit are refused."""
    farm = FarmConfig(world=WorldConfig(1, 1, 1, sensors=12, plots_x=4, plots_y=4, steps=6))
    config, team = RunConfig(farm=farm), farm_team(farm)
    store = PolicyStore(team)
    own, others = TeamActors.initial(team, 4, 0), TeamActors.initial(team, 4, 1)
    store.offer_parameters(ParametersMessage(1, 3, 0, 1, 0.0, team.digest, 4, own.head, own.flat))
    endpoint = free_endpoint()
    with Bus.listen(endpoint, "control") as here, Bus.connect(endpoint, "control", 10.0) as there:
        evaluations = EvaluationService(here, config, "r", "0", store, lambda: False)

        def rewards(flat, version):
            order = EvaluationOrder(1, 1, version, (3,), (4,), flat)
            return EvaluationResult.decode(answered(there, evaluations, order))

        given, newest, same = rewards(others.flat, 9), rewards(None, 3), rewards(own.flat, 2)
        assert (given.version, newest.version, same.version) == (9, 3, 2)
        assert np.array_equal(newest.reward, same.reward)
        assert not np.array_equal(given.reward, same.reward)
        with pytest.raises(BusError, match="actors are float32"):
            rewards(tuple(flat[:, 1:] for flat in own.flat), 3)


def test_a_worker_has_the_arguments_that_its_learner_publishes(monkeypatch):
    """A learner that knows of no change, because it was restarted, has the configured ones."""
    worker, _, _ = a_collecting_worker(monkeypatch, cuts=True)
    given = []
    worker._collector.change_arguments = given.append
    for published in ("", '{"size": 9}', '{"size": 9}', ""):
        worker._learner.arguments = published
        worker._renew_arguments()
    assert given == ['{"size": 9}', "{}"]
