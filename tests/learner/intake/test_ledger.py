"""The ledger takes each chunk once, in order, and explains every environment step."""

import queue
import threading
from dataclasses import replace
from types import SimpleNamespace

import pytest

from eia_sec.common.errors import CheckpointError
from eia_sec.common.protocol.messages import Envelope
from eia_sec.learner.intake.ledger import OTHERS, Ledger
from eia_sec.learner.intake.receiver import Receiver


def sender(sequence: int, incarnation: int = 1, name: str = "w") -> Envelope:
    return Envelope("rollout", name, incarnation, sequence)


def deliver(
    ledger: Ledger, sequence: int, *, oldest: int | None = None, steps: int = 10, incarnation: int = 1, flown: int = 0
) -> str:
    who = sender(sequence, incarnation)
    status = ledger.judge(who, sequence if oldest is None else oldest)
    if status == "accepted":
        ledger.accept(who, steps, produced=sequence * steps, flown=max(flown, sequence * steps))
    return status


def test_in_order_chunks_are_accepted_once() -> None:
    """A number that was taken before is a duplicate, however often it comes."""
    ledger = Ledger()
    assert [deliver(ledger, k) for k in (1, 2, 2, 1, 3)] == [
        "accepted",
        "accepted",
        "duplicate",
        "duplicate",
        "accepted",
    ]
    totals = ledger.totals()
    assert (totals["produced"], totals["accepted"], totals["duplicates"], totals["in_flight"]) == (30, 30, 2, 0)


def test_a_gap_that_the_worker_can_close_is_refused() -> None:
    """A chunk that overtook an older one, which the worker still holds, has to wait."""
    ledger = Ledger()
    deliver(ledger, 1)
    assert deliver(ledger, 3, oldest=2) == "gap"
    assert [deliver(ledger, 2), deliver(ledger, 3)] == ["accepted", "accepted"]
    assert ledger.totals()["lost"] == 0


def test_what_can_no_longer_arrive_is_declared_lost() -> None:
    """When the worker no longer holds what is missing, the steps between are lost and counted."""
    ledger = Ledger()
    deliver(ledger, 1)
    assert deliver(ledger, 4) == "accepted"
    totals = ledger.totals()
    assert (totals["accepted"], totals["lost"], totals["produced"], totals["in_flight"]) == (20, 20, 40, 0)


def test_a_refused_chunk_is_booked_as_rejected() -> None:
    """The number of a refused chunk is spent, and its steps are rejected, not lost."""
    ledger = Ledger()
    deliver(ledger, 1)
    ledger.refuse(sender(2))
    assert deliver(ledger, 3) == "accepted"
    totals = ledger.totals()
    assert (totals["rejected"], totals["lost"], totals["refused"], totals["in_flight"]) == (10, 0, 1, 0)


def test_a_refused_chunk_behind_a_gap_does_not_explain_the_gap() -> None:
    """Nobody knows which of the missing steps were in refused chunks, so all up to the next good one are lost."""
    ledger = Ledger()
    deliver(ledger, 1)
    ledger.refuse(sender(5))
    ledger.refuse(sender(6))
    assert deliver(ledger, 7) == "accepted"
    totals = ledger.totals()
    assert (totals["lost"], totals["rejected"], totals["refused"], totals["unexplained"]) == (50, 0, 2, 0)
    ledger.refuse(sender(8))
    assert deliver(ledger, 9) == "accepted"
    assert (ledger.totals()["lost"], ledger.totals()["rejected"]) == (50, 10)


def test_a_new_start_counts_from_one_again() -> None:
    """A worker that was restarted keeps what it delivered before, and its sequence begins anew."""
    ledger = Ledger()
    deliver(ledger, 1)
    deliver(ledger, 2)
    assert deliver(ledger, 1, incarnation=2) == "accepted"
    assert ledger.totals()["accepted"] == 30


def test_what_a_killed_worker_still_held_is_lost_and_counted() -> None:
    """Steps that a start had flown when it last sent are in flight, and lost once a new start has taken its place."""
    ledger = Ledger()
    deliver(ledger, 1, flown=90)
    totals = ledger.totals()
    assert (totals["produced"], totals["accepted"], totals["in_flight"], totals["lost"]) == (90, 10, 80, 0)
    deliver(ledger, 1, incarnation=2)
    totals = ledger.totals()
    assert (totals["produced"], totals["accepted"], totals["in_flight"], totals["lost"]) == (100, 20, 0, 80)


def test_state_and_restore() -> None:
    """A restored ledger still knows what it has, so nothing is counted twice after a restart."""
    ledger, again = Ledger(), Ledger()
    deliver(ledger, 1)
    deliver(ledger, 2)
    again.restore(ledger.state())
    assert deliver(again, 2) == "duplicate"
    assert again.totals()["accepted"] == ledger.totals()["accepted"]
    with pytest.raises(CheckpointError):
        again.restore({"closed": {}, "workers": {"w": {"nonsense": 1}}})


def produce(ledger: Ledger, name: str, sequence: int, steps: int, incarnation: int = 1, flown: int = 0) -> None:
    who = sender(sequence, incarnation, name)
    assert ledger.judge(who, sequence) == "accepted"
    ledger.accept(who, steps, produced=sequence * steps, flown=flown)


def assert_columns_add_up(totals: dict[str, int], rows: dict[str, dict[str, int]], flown: int) -> None:
    """Assert that rows make up the totals, and fates what workers said that they had flown."""
    for name, total in totals.items():
        assert sum(row[name] for row in rows.values()) == total, name
    for row in (totals, *rows.values()):
        assert row["produced"] == row["accepted"] + row["lost"] + row["rejected"] + row["in_flight"]
    assert totals["produced"] == flown


def test_every_worker_has_an_account_over_all_its_starts() -> None:
    """Rows of single workers hold earlier starts too, and add up to the totals, also after a checkpoint."""
    ledger, again = Ledger(), Ledger()
    produce(ledger, "a", 1, 10, flown=50)
    produce(ledger, "a", 1, 10, incarnation=2)
    produce(ledger, "a", 1, 10, incarnation=3, flown=30)
    produce(ledger, "b", 1, 7)
    again.restore(ledger.state())
    for one in (ledger, again):
        totals, rows = one.accounts()
        assert list(rows) == ["a", "b"]
        assert [rows["a"][name] for name in ("produced", "accepted", "lost", "in_flight")] == [90, 30, 40, 20]
        assert (rows["b"]["produced"], rows["b"]["accepted"]) == (7, 7)
        assert_columns_add_up(totals, rows, flown=50 + 10 + 30 + 7)


def test_of_many_workers_those_in_trouble_and_the_busiest_are_listed_and_the_others_summed() -> None:
    """With more workers than rows the unlucky come first, then the busiest, and one row sums all others."""
    ledger = Ledger()
    for index in range(60):
        produce(ledger, f"w{index}", 1, 10 + index)
    produce(ledger, "w3", 1, 5, incarnation=2)
    produce(ledger, "w5", 4, 15)
    totals, rows = ledger.accounts(4)
    assert list(rows) == ["w5", "w59", "w58", "w57", OTHERS]
    assert rows["w5"]["lost"] == 30
    assert rows[OTHERS]["workers"] == 56
    assert_columns_add_up(totals, rows, flown=sum(range(10, 70)) + 5 + 60 - 15)


def flight(ledger: Ledger) -> int:
    """Book all that can become of steps, also out of order and over two starts; return what the workers have flown."""
    produce(ledger, "a", 1, 10, flown=90)
    assert ledger.judge(sender(1, name="a"), 1) == "duplicate"
    ledger.refuse(sender(2, name="a"))
    produce(ledger, "a", 3, 10, flown=40)  # an older request, which says less than the first one
    produce(ledger, "a", 6, 10, flown=90)
    ledger.refuse_aged(sender(7, name="a"), 10, 70, 90)
    ledger.lose(sender(8, name="a"), 10, 80, 95)
    produce(ledger, "b", 1, 7, flown=3)  # flown is written after the chunk is made
    produce(ledger, "a", 1, 10, incarnation=2, flown=30)
    return 95 + 7 + 30


def test_the_ledger_closes_against_what_workers_say() -> None:
    """Duplicates, refusals, losses, requests out of order and a killed start leave nothing unexplained."""
    ledger = Ledger()
    flown = flight(ledger)
    totals, rows = ledger.accounts()
    assert [totals[name] for name in ("accepted", "lost", "claimed", "rejected", "in_flight")] == [47, 45, 20, 20, 20]
    assert_columns_add_up(totals, rows, flown)
    assert ledger.unexplained() == 0


def test_losses_that_only_a_worker_claims_are_shown_apart() -> None:
    """A start that is met for the first time may claim any number of earlier steps; real losses can still be seen."""
    ledger, far = Ledger(), 2**40
    assert ledger.judge(sender(far, name="liar"), far) == "accepted"
    assert ledger.accept(sender(far, name="liar"), 10, far * 10, far * 10) == (far - 1) * 10
    produce(ledger, "honest", 1, 10, flown=30)
    ledger.lose(sender(2, name="honest"), 10, 20, 30)
    for start in (2, 3):  # the claims of an ended start stay apart
        totals, rows = ledger.accounts()
        assert totals["claimed"] == rows["liar"]["claimed"] == rows["liar"]["lost"] == (far - 1) * 10
        assert (rows["honest"]["claimed"], rows["honest"]["lost"], totals["lost"] - totals["claimed"]) == (0, 10, 10)
        produce(ledger, "liar", 1, 10, incarnation=start)
    state = ledger.state()
    again = Ledger()
    again.restore(state)
    assert again.totals() == ledger.totals()
    del state["closed"]["claimed"]
    with pytest.raises(CheckpointError, match="a field is missing"):
        again.restore(state)


@pytest.mark.parametrize("times", [0, 2])
@pytest.mark.parametrize("fate", ["accepted", "lost", "rejected"])
@pytest.mark.parametrize("ends", [False, True])
def test_a_ledger_that_books_wrongly_is_unexplained(times: int, fate: str, ends: bool) -> None:
    """Each fate that is booked twice, or not at all, shows by exactly its steps, also after the start has ended."""
    ledger = Ledger()
    produce(ledger, "w", 1, 10)
    before = getattr(ledger.workers["w"], fate)
    {"accepted": ledger.accept, "lost": ledger.lose, "rejected": ledger.refuse_aged}[fate](sender(2), 10, 20, 20)
    ledger.workers["w"] = replace(ledger.workers["w"], **{fate: before + 10 * times})
    produce(ledger, "w", 3, 10, flown=50)
    if ends:
        produce(ledger, "w", 1, 10, incarnation=2)
    totals, rows = ledger.accounts()
    assert ledger.unexplained() == 10
    assert totals["unexplained"] == rows["w"]["unexplained"] == 10 * (1 - times)
    assert totals["in_flight"] == (0 if ends else 20)


def test_two_errors_do_not_make_up_for_each_other() -> None:
    """Steps forgotten of one worker and as many booked twice of another are both counted."""
    ledger = Ledger()
    for name, accepted in (("a", 0), ("b", 20)):
        produce(ledger, name, 1, 10)
        ledger.workers[name] = replace(ledger.workers[name], accepted=accepted)
    assert ledger.totals()["unexplained"] == 0
    assert ledger.unexplained() == 20


@pytest.mark.parametrize(("booked", "in_replay", "said"), [(10, 10, 0), (10, 7, 3), (20, 20, 10), (0, 10, 20)])
def test_unexplained_adds_up_both_defects(booked: int, in_replay: int, said: int) -> None:
    """Its figure holds what the accounts fail to close by, and what of the accepted is not in replay; sizes add up."""
    ledger = Ledger()
    produce(ledger, "w", 1, 10)
    ledger.workers["w"] = replace(ledger.workers["w"], accepted=booked)
    receiver = SimpleNamespace(gate=threading.Lock(), ledger=ledger, arrivals=queue.Queue())
    assert Receiver.unexplained(receiver, in_replay) == said
