"""Who may fly for an iteration: nothing is flown that is learned from too late, and nobody waits for good."""

import threading
from dataclasses import replace

import pytest

from eia_sec.common.config.presets import preset
from eia_sec.common.protocol.codec import NO_LIMIT
from eia_sec.learner.intake.iteration_room import STALL_MOST, STALL_SECONDS, IterationRoom
from eia_sec.learner.intake.limits import IntakeLimits
from tests.learner.intake.simulated_workers import Simulation


class Field:
    """Workers that fly one chunk after each answer, and a learner that opens iterations; no time passes by itself."""

    def __init__(self, *, workers: int, chunk: int, iteration: int, most_lag: int = 1) -> None:
        self.now, self.version, self.iteration, self.size = 0.0, 1, 0, iteration
        self.gate = threading.Lock()
        limits = IntakeLimits(64, most_lag, iteration, chunk)
        self.room = IterationRoom(limits, self.version, self.gate, lambda: self.now)
        self.chunk = chunk
        self.answers: dict[str, tuple[int, int]] = {}
        self.room.open(0, iteration, updating=False)
        self.names = [str(index) for index in range(workers)]

    def land(self, worker: str) -> bool:
        """Deliver a worker's chunk; return whether it may fly the next one."""
        self.answers.pop(worker, None)
        with self.gate:
            self.room.take(self.chunk)
        self.room.answer(worker, lambda terms: self.answers.__setitem__(worker, terms[:2]))
        return worker in self.answers

    def fill(self) -> None:
        """Begin the updates of the open iteration, and open the next."""
        self.iteration += 1
        self.room.open(self.iteration, self.size, updating=True)

    def publish(self, *, updating: bool = False) -> None:
        """Publish the version that the updates have made."""
        self.version += 1
        self.room.set_version(self.version, updating=updating)


def test_while_updates_run_workers_fly_what_the_next_iteration_takes():
    """Four workers with chunks of half an iteration: two fly at a time, first come first served, and all fit."""
    field = Field(workers=4, chunk=500, iteration=1000)
    field.iteration = 1
    field.room.open(1, 0, updating=True)
    assert not any(field.land(worker) for worker in "0123")
    for waiting in ("01", "23", "01"):
        field.publish(updating=True)
        field.fill()
        assert field.answers == {worker: (field.version, 1) for worker in waiting}
        assert [field.land(worker) for worker in waiting] == [False, False]
        assert field.room.steps == 0


def test_many_workers_with_few_steps_fly_on_without_waiting():
    """With room for two chunks of each, answers give a window of a chunk or more, and nobody is held."""
    field = Field(workers=16, chunk=25, iteration=1000)
    assert all(field.land(worker) for worker in field.names)
    assert all(window >= 25 for _, window in field.answers.values())
    assert field.room.terms.window >= 25


def test_before_updates_begin_an_iteration_more_may_be_flown():
    """What does not fit into the open iteration enters the next one, a version old."""
    field = Field(workers=3, chunk=1000, iteration=1000)
    assert [field.land(worker) for worker in field.names[:2]] == [True, False]
    assert field.room.steps == -1000


def test_strictly_on_policy_nobody_flies_during_updates():
    """With L = 0 answers wait for the version that the updates make, and ask for it."""
    field = Field(workers=2, chunk=100, iteration=1000, most_lag=0)
    assert field.land("0")
    field.fill()
    assert field.room.terms.window == 0
    assert not field.land("0")
    field.publish()
    assert field.answers["0"][0] == 2


@pytest.mark.parametrize("imitated", [(), (6,), (5, 6), (4,)])
@pytest.mark.parametrize("most_lag", [0, 1, 3])
def test_an_answer_asks_for_a_version_that_is_still_learned_from(most_lag, imitated):
    """A worker that is answered at once may fly with the oldest version that is not refused, imitations or not."""
    field = Field(workers=1, chunk=100, iteration=1000, most_lag=most_lag)
    for version in (2, 3, 4, 5, 6):
        field.room.set_version(version, imitated=version in imitated)
    field.land("0")
    (required, _) = field.answers["0"]
    with field.gate:
        assert field.room.refusal(required) == ""
        assert required == 0 or field.room.refusal(required - 1) != ""


def test_a_worker_that_left_counts_until_its_chunk_would_be_too_old():
    """Whoever waits behind it flies with the next but one version at the latest."""
    field = Field(workers=2, chunk=500, iteration=1000)
    field.fill()
    assert field.land("left")
    field.room.open(1, 500, updating=True)
    assert not field.land("0")
    field.publish(updating=True)
    assert not field.answers.get("0")
    field.iteration, field.size = 1, 500
    field.fill()
    assert field.answers["0"] == (2, 1)


def test_after_a_silence_nobody_is_waited_for():
    """When those who may fly deliver nothing for a while, the others fly instead."""
    field = Field(workers=3, chunk=2000, iteration=1000)
    assert field.land("left")
    field.room.open(1, 1000, updating=True)
    field.publish()
    assert not field.land("0")
    field.publish(updating=True)
    field.iteration = 1
    field.fill()
    assert field.answers.pop("0")
    field.room.open(field.iteration, 1000, updating=True)
    field.room.answer("1", lambda terms: field.answers.__setitem__("1", terms[:2]))
    for seconds, answered in ((0.0, False), (STALL_SECONDS - 0.1, False), (0.2, True)):
        field.now += seconds
        field.room.open(field.iteration, 1000, updating=True)
        assert ("1" in field.answers) == answered


def test_a_copy_of_a_held_request_is_answered_without_leave_to_fly():
    """A worker that ends asks again soon; its first request stays unanswered."""
    field = Field(workers=1, chunk=1000, iteration=1000, most_lag=0)
    assert not field.land("0")
    found = []
    field.room.answer("0", lambda terms: found.append(terms[:2]))
    assert found == [(0, 0)]
    assert not field.room.holds("0")


def test_without_iterations_nothing_is_limited():
    """A learner that takes in all the time, or that drains, answers everybody with NO_LIMIT."""
    field = Field(workers=2, chunk=1000, iteration=1000, most_lag=0)
    assert not field.land("0")
    field.room.lift()
    assert field.answers == {"0": (0, NO_LIMIT)}
    assert field.land("1")
    assert field.room.terms.window == NO_LIMIT


@pytest.mark.parametrize(
    ("workers", "chunk", "iteration", "flight", "update"),
    [
        (1, 25, 1000, 0.5, 0.1),
        (16, 25, 1000, 0.5, 0.1),
        (32, 25, 1000, 0.5, 0.1),
        (32, 25, 1000, 0.5, 1.0),
        (100, 25, 1000, 0.5, 2.0),
        (1, 8000, 16_000, 0.25, 1.0),
        (2, 8000, 16_000, 0.25, 1.0),
        (4, 8000, 16_000, 0.25, 1.0),
        (4, 8000, 16_000, 2.0, 5.0),
        (16, 8000, 16_000, 0.5, 1.0),
    ],
)
def test_nothing_is_flown_for_nothing_and_nobody_waits_longer_than_he_must(workers, chunk, iteration, flight, update):
    """After the first seconds no chunk comes too late, and workers or the learner are busy all the time."""
    run = Simulation(workers, chunk, iteration, flight, update)
    run.run(20.0 * max(flight, update))
    run.refused = 0
    rate = run.run(300.0)
    assert run.refused == 0
    assert rate >= 0.95 * min(workers * chunk / flight, iteration / update)


@pytest.mark.parametrize("update", [0.1, 1.5])
@pytest.mark.parametrize("workers", [1, 2, 3, 4, 6])
def test_however_many_workers_share_an_iteration_none_waits(workers, update):
    """Two whole chunks of slow environments fill an iteration; shorter ones let every worker work."""
    run = Simulation(workers, chunk=1000, iteration=2000, flight=20.0, update=update, least=400)
    run.run(60.0)
    run.refused = 0
    assert run.run(600.0) >= 0.95 * min(workers * 1000 / 20.0, 2000 / update)
    assert run.refused == 0


def test_workers_that_have_not_delivered_yet_share_the_first_iteration():
    """What is published before the first chunk comes lets all of those who are there begin with their share."""
    limits = IntakeLimits(64, 1, 2000, 1000, 128)
    room = IterationRoom(limits, 1, threading.Lock(), lambda: 0.0)
    room.open(0, 2000, updating=False)
    for present, asked in ((0, 1000), (1, 1000), (2, 1000), (4, 500), (100, 128)):
        room.present = present
        assert room.terms.asked_steps == asked


def test_chunks_stay_whole_where_shorter_ones_teach_worse():
    """Hindsight pays visits of whole episodes, networks with memory learn whole sequences; advantages look ahead."""
    generic = preset("generic")
    assert IntakeLimits.of(generic).least_steps == 51 * generic.rollout.environments
    for seen in ({"gae_lambda": 1.0, "discount": 1.0}, {"gae_lambda": 0.99, "discounts": {"a": 1.0}}):
        far = replace(generic, algorithm=replace(generic.on_policy, **seen))
        assert IntakeLimits.of(far).least_steps == 125 * generic.rollout.environments
    memory = replace(generic, algorithm=replace(generic.on_policy, memory="gru", sequence_steps=25))
    assert IntakeLimits.of(memory).least_steps is None
    assert IntakeLimits.of(preset("instant")).least_steps is None


def test_a_worker_that_leaves_stops_nobody():
    """With leave to fly for half of an iteration it never comes again; the others go on at their rate."""
    run = Simulation(3, 8000, 16_000, 0.5, 1.0, gone=1)
    assert run.run(60.0) >= 0.9 * 16_000


def test_one_slow_worker_does_not_stall_the_others():
    """Others wait for twice a typical flight and half a minute, not for a multiple of the slowest worker's flight."""
    field = Field(workers=3, chunk=500, iteration=1000, most_lag=0)

    def ask(worker):
        field.answers.pop(worker, None)
        field.room.answer(worker, lambda terms: field.answers.__setitem__(worker, terms[:2]))
        return worker in field.answers

    assert ask("slow")
    field.now += 300.0
    assert ask("slow")
    for _ in range(8):
        assert ask("fast")
        field.now += 1.0
    assert not ask("waiting")
    for seconds, answered in ((STALL_MOST, False), (3.0, True)):
        field.now += seconds
        field.room.open(0, 1000, updating=False)
        assert ("waiting" in field.answers) == answered
    assert field.room.given_up == 2
