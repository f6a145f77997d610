"""The receiver of a learner that learns on policy: iterations take in their steps, and no chunk that is too old."""

from contextlib import contextmanager

import numpy as np
import pytest

from eia_sec.common.errors import SchemaError
from eia_sec.common.farm import METRIC_NAMES
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.chunk_messages import from_message, to_message, to_request
from eia_sec.common.protocol.codec import NO_LIMIT
from eia_sec.common.protocol.messages import Envelope, ProgressMessage
from tests.faults.tools.channel import RUN, TEAM, Parcel, a_chunk, front_door, shut, with_log_probabilities
from tests.system.fleet import until


@contextmanager
def opened(**limits):
    """Give a receiver and its door, with version 1 published."""
    receiver, door = front_door(**limits)
    receiver.room.set_version(1)
    try:
        yield receiver, door
    finally:
        shut(receiver, door)


def parcel(number, version=1):
    """Return a request with one chunk of one environment step, flown with this version."""
    payload = to_request([to_message(a_chunk(number), TEAM, version, number).encode()], oldest=number, flown=number)
    envelope = Envelope("rollout", "0", 1, number, version)
    return Parcel(keys.TRANSITION.key(RUN, worker="0"), payload, envelope.encode())


def waits(door, receiver, request):
    """Deliver a request; return whether the receiver holds its answer back, the queue as it was."""
    before = receiver.arrivals.qsize()
    door.push(request)
    return not request.answered.wait(0.3) and receiver.arrivals.qsize() == before


def held(door, receiver, request):
    """Deliver a request; return whether its chunk is taken and only the answer waits."""
    before = receiver.arrivals.qsize()
    door.push(request)
    until(lambda: receiver.arrivals.qsize() > before, "a chunk in the queue")
    return not request.answered.wait(0.3)


def test_strictly_on_policy_nothing_older_is_taken():
    """Once updates have begun, a chunk of the version before is refused, and the ledger counts it as aged."""
    with opened(most_lag=0, iteration_steps=2) as (receiver, door):
        receiver.room.open(0, 2, updating=False)
        assert door.pass_on(parcel(1)).verdict == "accepted"
        second = parcel(2)
        assert held(door, receiver, second)
        receiver.room.open(1, 2, updating=True)
        assert not second.answered.wait(0.1)
        receiver.room.set_version(2)
        assert second.answered.wait(60.0)
        assert (second.verdict, second.answer.required_version) == ("accepted", 2)
        assert [door.pass_on(parcel(number)).verdict for number in (3, 4)] == ["refused", "refused"]
        assert door.pass_on(parcel(5, version=2)).verdict == "accepted"
        totals = receiver.ledger.totals()
        assert {name: totals[name] for name in ("accepted", "rejected", "refused", "aged", "lost")} == {
            "accepted": 3,
            "rejected": 2,
            "refused": 2,
            "aged": 2,
            "lost": 0,
        }
        assert receiver.unexplained(absorbed=0) == 0


def test_one_version_of_lag_is_taken():
    """With `max_lag_versions` 1, chunks flown during updates enter the next iteration, and none two versions old."""
    with opened(most_lag=1, iteration_steps=3) as (receiver, door):
        receiver.room.open(0, 1, updating=False)
        assert door.pass_on(parcel(1)).verdict == "accepted"
        receiver.room.open(1, 3, updating=True)
        assert door.pass_on(parcel(2)).verdict == "accepted"
        receiver.room.set_version(2)
        assert door.pass_on(parcel(3)).verdict == "accepted"
        receiver.room.set_version(3)
        assert door.pass_on(parcel(4)).verdict == "refused"
        assert receiver.ledger.totals()["aged"] == 1
        assert receiver.unexplained(absorbed=0) == 0


def test_a_full_iteration_makes_workers_wait():
    """A chunk beyond an iteration's steps is taken when the next opens, and asking again opens nothing."""
    with opened(most_lag=1, iteration_steps=9) as (receiver, door):
        receiver.room.open(0, 2, updating=False)
        assert [door.pass_on(parcel(number)).verdict for number in (1, 2)] == ["accepted", "accepted"]
        third = parcel(3)
        assert waits(door, receiver, third)
        receiver.room.open(0, 2, updating=False)
        assert not third.answered.wait(0.1)
        receiver.room.open(1, 1, updating=False)
        assert third.answered.wait(60.0)
        assert third.verdict == "accepted"
        assert waits(door, receiver, parcel(4))
        assert receiver.room.steps == 0


def test_age_is_that_when_a_chunk_is_taken():
    """A chunk that waited until another version was published is as old as that makes it."""
    with opened(most_lag=0, iteration_steps=1) as (receiver, door):
        receiver.room.open(0, 1, updating=False)
        assert held(door, receiver, parcel(1))
        second = parcel(2)
        assert waits(door, receiver, second)
        receiver.room.set_version(2)
        receiver.room.open(1, 1, updating=False)
        assert second.answered.wait(60.0)
        assert second.verdict == "refused"
        assert "its policy is 1 versions old" in second.answer.reasons[0]
        assert held(door, receiver, parcel(3, version=2))


def test_an_imitation_event_makes_no_chunk_older():
    """Its version counts for publishing alone, so what was under way is still learned from."""
    with opened(most_lag=1, iteration_steps=1) as (receiver, door):
        receiver.room.set_version(2)
        receiver.room.set_version(3, imitated=True)
        receiver.room.open(0, 2, updating=False)
        assert door.pass_on(parcel(1, version=1)).verdict == "accepted"
        receiver.room.set_version(4)
        assert "its policy is 2 versions old" in door.pass_on(parcel(2, version=1)).answer.reasons[0]


def test_a_draining_learner_takes_everything():
    """Chunks that wait for an iteration, and all that follow, are taken without one."""
    with opened(most_lag=1, iteration_steps=1) as (receiver, door):
        receiver.room.open(0, 1, updating=True)
        first, second = parcel(1), parcel(2)
        assert held(door, receiver, first)
        assert waits(door, receiver, second)
        receiver.room.lift()
        assert first.answered.wait(60.0)
        assert second.answered.wait(60.0)
        assert [second.verdict, *(door.pass_on(parcel(n)).verdict for n in range(3, 9))] == ["accepted"] * 7
        assert receiver.ledger.totals()["accepted"] == receiver.arrivals.qsize() == 8


def test_a_worker_that_asks_again_is_answered():
    """A copy of a request whose answer is held back gets one without leave to fly, and no penalty."""
    with opened(most_lag=0, iteration_steps=1) as (receiver, door):
        receiver.room.open(0, 1, updating=False)
        first = parcel(1)
        assert held(door, receiver, first)
        again = door.pass_on(parcel(1))
        assert (again.verdict, again.answer.window) == ("duplicate", 0)
        assert not receiver.peer_penalties.counts()
        receiver.room.set_version(2)
        assert not first.answered.wait(0.1)


def test_answers_say_how_much_may_be_under_way():
    """Without iterations nothing limits workers."""
    with opened(most_lag=0, iteration_steps=2) as (receiver, door):
        assert door.pass_on(parcel(1)).answer.window == NO_LIMIT
        assert (receiver.room.steps, receiver.room.terms.window) == (None, NO_LIMIT)
        receiver.room.open(0, 2, updating=False)
        assert door.pass_on(parcel(2)).answer.window == 1
        assert (receiver.room.steps, receiver.room.terms.window) == (1, 1)
        receiver.room.open(1, 2, updating=True)
        assert (receiver.room.steps, receiver.room.terms.window) == (2, 0)


def test_progress_without_a_limit_can_be_read():
    """Its message survives the wire, as does that of a learner whose iteration is full."""
    for window in (NO_LIMIT, 0):
        message = ProgressMessage(1, 1, 0, 1, 10, 1, "training", window)
        assert ProgressMessage.decode(message.encode()) == message
    assert ProgressMessage(1, 1, 0, 1, 10, 1, "training").window == NO_LIMIT


def test_a_learner_that_closes_lets_nobody_wait():
    """A chunk that waits for an iteration is answered as closed, and stays the worker's."""
    with opened(most_lag=1, iteration_steps=9) as (receiver, door):
        receiver.room.open(0, 1, updating=False)
        door.pass_on(parcel(1))
        second = parcel(2)
        assert waits(door, receiver, second)
        receiver.close()
        until(second.answered.is_set, "an answer")
        assert second.verdict == "closed"
        assert receiver.ledger.totals()["accepted"] == 1


@pytest.mark.parametrize("on_policy", [False, True])
def test_rows_have_log_probabilities_where_the_algorithm_needs_them(on_policy):
    """A chunk without those of an on-policy run, or with some in another run, is refused; they travel unchanged."""
    plain, other = a_chunk(1), with_log_probabilities(a_chunk(1))
    fitting, wrong = (other, plain) if on_policy else (plain, other)
    found = from_message(to_message(fitting, TEAM, 1, 1), TEAM, METRIC_NAMES, on_policy=on_policy)
    assert (found.rows.log_probability is not None) == on_policy
    if on_policy:
        assert np.array_equal(found.rows.log_probability, other.rows.log_probability)
    with pytest.raises(SchemaError, match="log-probabilities"):
        from_message(to_message(wrong, TEAM, 1, 1), TEAM, METRIC_NAMES, on_policy=on_policy)
