"""The learner's front door: what it hands on with a chunk, and when its answers come."""

import numpy as np

from eia_sec.common.incarnation import LATEST, STRIDE, new_incarnation
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.chunk_messages import to_message, to_request
from eia_sec.common.protocol.messages import ChunkAck, Envelope
from eia_sec.learner.intake.ledger import Ledger
from eia_sec.learner.intake.limits import IntakeLimits
from tests.faults.tools.channel import (
    RULES,
    RUN,
    TEAM,
    Door,
    Parcel,
    Sending,
    a_chunk,
    front_door,
    next_arrival,
    receiving,
    shut,
)
from tests.system.fleet import until


def parcel(worker: str, start: int, number: int, *, lawful: bool = True) -> Parcel:
    """Return a request with one chunk of one environment step."""
    chunk = a_chunk(number)
    if not lawful:
        chunk.rows.observation[0, 0] = np.nan
    payload = to_request([to_message(chunk, TEAM, 1, produced=number).encode()], oldest=number, flown=number)
    return Parcel(
        keys.TRANSITION.key(RUN, worker=worker), payload, Envelope("rollout", worker, start, number, 1).encode()
    )


def test_a_chunk_brings_the_accounts_of_its_moment():
    """What a checkpoint gets after each chunk counts every start of a worker once, whoever sent the chunk.

    A worker's new start whose first chunk is refused has ended the old one, though it has brought no chunk itself.
    """
    receiver, door = front_door()
    try:
        answers = [
            door.pass_on(parcel(*request, lawful=lawful)).verdict
            for *request, lawful in [("a", 1, 1, True), ("b", 1, 1, True), ("a", 2, 1, False), ("b", 1, 2, True)]
        ]
        assert answers == ["accepted", "accepted", "refused", "accepted"]
        accepted = []
        for _ in range(3):
            arrival = until(lambda: next_arrival(receiver, 0.05), "a chunk")
            kept = Ledger()
            kept.restore(arrival.ledger.state())
            accepted.append(kept.totals()["accepted"])
        assert accepted == [1, 2, 3]
        again = Ledger()
        again.restore(arrival.ledger.state())
        assert again.totals() == receiver.ledger.totals()
        assert again.unexplained() == 0
    finally:
        shut(receiver, door)


def test_an_older_start_learns_that_it_was_replaced():
    """It gets its own verdict, which costs the newer start under the same name nothing, and is counted."""
    receiver, door = front_door()
    try:
        assert door.pass_on(parcel("a", 2, 1)).verdict == "accepted"
        for _ in range(200):
            assert door.pass_on(parcel("a", 1, 1)).verdict == "replaced"
        assert door.pass_on(parcel("a", 2, 2)).verdict == "accepted"
        assert (receiver.replaced, receiver.malformed) == (200, 0)
        assert receiver.ledger.newest_incarnation("a") == 2
        assert receiver.ledger.newest_incarnation("b") == 0
    finally:
        shut(receiver, door)


def test_a_successor_goes_on_after_chunks_that_the_learner_before_has_taken():
    """A learner that was thought dead settles a chunk after its successor met the worker; its steps count as lost."""
    (old, old_door), new_door = front_door(), Door()
    new = receiving(new_door, RULES, IntakeLimits(64, None), resumed=True)
    try:
        # Both take the first two chunks, as answers get lost; then the old one answers for the third.
        for number, doors in ((1, (old_door, new_door)), (2, (old_door, new_door)), (3, (old_door,)), (4, (new_door,))):
            assert [door.pass_on(parcel("a", 1, number)).verdict for door in doors] == ["accepted"] * len(doors)
        totals = new.ledger.totals()
        assert (totals["accepted"], totals["lost"], totals["claimed"], totals["unexplained"]) == (3, 1, 1, 0)
        # Out of turn is still what the worker itself can mend.
        ahead = to_request([to_message(a_chunk(6), TEAM, 1, produced=6).encode()], oldest=5, flown=6)
        sent = Parcel(keys.TRANSITION.key(RUN, worker="a"), ahead, Envelope("rollout", "a", 1, 6, 1).encode())
        assert new_door.pass_on(sent).verdict == "gap"
    finally:
        shut(old, old_door)
        shut(new, new_door)


def test_no_start_takes_all_numbers_with_it():
    """A hostile number beyond any clock is refused; behind the greatest one that is taken a new start still gets in."""
    receiver, door = front_door()
    try:
        assert "is not plausible" in door.pass_on(parcel("a", 2**63 - 1, 1)).refused
        assert "is not plausible" in door.pass_on(parcel("a", LATEST + STRIDE + 1, 1)).refused
        assert door.pass_on(parcel("a", LATEST, 1)).verdict == "accepted"
        for _ in range(3):
            known = receiver.ledger.newest_incarnation("a")
            assert door.pass_on(parcel("a", new_incarnation(known), 1)).verdict == "accepted"
            assert known < receiver.ledger.newest_incarnation("a") <= known + STRIDE
    finally:
        shut(receiver, door)


def test_a_stray_message_keeps_no_worker_out_of_a_lockstep_run():
    """Whoever sends junk before the one worker has no place in the run; the worker that delivers first has it."""
    door = Door()
    bounds = IntakeLimits(16, None)
    receiver = receiving(door, RULES, bounds, lockstep=True)
    try:
        stray = parcel("stranger", 1, 1)
        stray.payload = b"junk"
        door.pass_on(stray)
        door.push(Sending("0", 1).parcel([1]))
        assert until(lambda: next_arrival(receiver, 0.05), "a chunk").sender.name == "0"
        assert "exactly one worker" in door.pass_on(parcel("late", 1, 1)).refused
    finally:
        shut(receiver, door)


def test_a_lockstep_run_ends_with_its_worker():
    """One that was restarted would repeat its first episodes; the learner ends, and takes nothing of it."""
    door = Door()
    bounds = IntakeLimits(16, None)
    receiver = receiving(door, RULES, bounds, lockstep=True)
    try:
        door.push(Sending("0", 1).parcel([1]))
        assert until(lambda: next_arrival(receiver, 0.05), "a chunk").sender.name == "0"
        assert not receiver.repeats
        assert "would repeat its first episodes" in door.pass_on(parcel("0", 2, 1)).refused
        assert receiver.repeats
    finally:
        shut(receiver, door)


def test_there_are_accounts_for_so_many_workers(monkeypatch):
    """Names without end are refused before they take memory, and stand in no checkpoint."""
    monkeypatch.setattr("eia_sec.learner.intake.receiver.MOST_WORKERS", 2)
    receiver, door = front_door()
    try:
        assert [door.pass_on(parcel(name, 1, 1)).verdict for name in ("a", "b")] == ["accepted"] * 2
        assert "already has accounts of 2 workers" in door.pass_on(parcel("c", 1, 1)).refused
        assert door.pass_on(parcel("a", 1, 2)).verdict == "accepted"
        assert set(receiver.ledger.workers) == {"a", "b"}
    finally:
        shut(receiver, door)


def test_in_lockstep_a_second_copy_waits_for_the_training_too():
    """A worker whose link broke while its chunk was trained on hears of it when that is done, and not before."""
    door, sending = Door(), Sending("0", 2)
    bounds = IntakeLimits(16, None)
    receiver = receiving(door, RULES, bounds, lockstep=True)
    try:
        first, second = sending.parcel([1]), sending.parcel([1])
        door.push(first)
        arrival = until(lambda: next_arrival(receiver, 0.05), "a chunk")
        door.push(second)
        # The third is of another worker, and its refusal says that the second has been looked at.
        assert "exactly one worker" in door.pass_on(Sending("1", 1).parcel([1])).refused
        assert not first.answered.is_set()
        assert not second.answered.is_set()
        arrival.owed.answer(ChunkAck(("accepted",), ("",), 2, 7).encode())
        assert second.answered.is_set()
        assert (second.answer.verdicts, second.answer.required_version) == (("accepted",), 7)
        assert door.pass_on(sending.parcel([1])).verdict == "duplicate"
        assert receiver.ledger.totals()["accepted"] == 1
    finally:
        shut(receiver, door)
