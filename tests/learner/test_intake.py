"""The intake takes each chunk once, in order, and its ledger explains every environment step."""

import pytest

from common.errors import CheckpointError
from common.messages import Envelope
from learner.intake import Intake


def sender(sequence: int, incarnation: int = 1, name: str = "w") -> Envelope:
    return Envelope("rollout", name, incarnation, sequence)


def deliver(
    intake: Intake, sequence: int, *, oldest: int | None = None, steps: int = 10, incarnation: int = 1, flown: int = 0
) -> str:
    who = sender(sequence, incarnation)
    status = intake.judge(who, sequence if oldest is None else oldest)
    if status == "accepted":
        intake.accept(who, steps, produced=sequence * steps, flown=max(flown, sequence * steps))
    return status


def test_in_order_chunks_are_accepted_once() -> None:
    """A number that was taken before is a duplicate, however often it comes."""
    intake = Intake()
    assert [deliver(intake, k) for k in (1, 2, 2, 1, 3)] == [
        "accepted",
        "accepted",
        "duplicate",
        "duplicate",
        "accepted",
    ]
    totals = intake.totals()
    assert (totals["produced"], totals["accepted"], totals["duplicates"], totals["in_flight"]) == (30, 30, 2, 0)


def test_a_gap_that_the_worker_can_close_is_refused() -> None:
    """A chunk that overtook an older one, which the worker still holds, has to wait."""
    intake = Intake()
    deliver(intake, 1)
    assert deliver(intake, 3, oldest=2) == "gap"
    assert [deliver(intake, 2), deliver(intake, 3)] == ["accepted", "accepted"]
    assert intake.totals()["lost"] == 0


def test_what_can_no_longer_arrive_is_declared_lost() -> None:
    """When the worker no longer holds what is missing, the steps between are lost and counted."""
    intake = Intake()
    deliver(intake, 1)
    assert deliver(intake, 4) == "accepted"
    totals = intake.totals()
    assert (totals["accepted"], totals["lost"], totals["produced"], totals["in_flight"]) == (20, 20, 40, 0)


def test_a_refused_chunk_is_booked_as_rejected() -> None:
    """The number of a refused chunk is spent, and its steps are rejected, not lost."""
    intake = Intake()
    deliver(intake, 1)
    intake.refuse(sender(2))
    assert deliver(intake, 3) == "accepted"
    totals = intake.totals()
    assert (totals["rejected"], totals["lost"], totals["refused"], totals["in_flight"]) == (10, 0, 1, 0)


def test_a_new_start_counts_from_one_again() -> None:
    """A worker that was restarted keeps what it delivered before, and its sequence begins anew."""
    intake = Intake()
    deliver(intake, 1)
    deliver(intake, 2)
    assert deliver(intake, 1, incarnation=2) == "accepted"
    assert intake.totals()["accepted"] == 30


def test_what_a_killed_worker_still_held_is_lost_and_counted() -> None:
    """Steps that a start had flown when it last sent are in flight, and lost once a new start has taken its place."""
    intake = Intake()
    deliver(intake, 1, flown=90)
    totals = intake.totals()
    assert (totals["produced"], totals["accepted"], totals["in_flight"], totals["lost"]) == (90, 10, 80, 0)
    deliver(intake, 1, incarnation=2)
    totals = intake.totals()
    assert (totals["produced"], totals["accepted"], totals["in_flight"], totals["lost"]) == (100, 20, 0, 80)


def test_state_and_restore() -> None:
    """A restored ledger still knows what it has, so nothing is counted twice after a restart."""
    intake, again = Intake(), Intake()
    deliver(intake, 1)
    deliver(intake, 2)
    again.restore(intake.state())
    assert deliver(again, 2) == "duplicate"
    assert again.totals()["accepted"] == intake.totals()["accepted"]
    with pytest.raises(CheckpointError):
        again.restore({"closed": {}, "workers": {"w": {"nonsense": 1}}})
