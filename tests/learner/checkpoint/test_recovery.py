"""A resumed learner books exactly what was acknowledged after its checkpoint, and takes none of it twice."""

import random

import pytest

from eia_sec.common.history.history import Entry, History
from eia_sec.common.protocol.messages import Envelope
from eia_sec.learner.checkpoint import recovery
from eia_sec.learner.checkpoint.recovery import recover_losses
from eia_sec.learner.intake.ledger import Ledger


def accepted(ledger: Ledger, history: History, worker: str, number: int, incarnation: int = 1) -> None:
    sender = Envelope("rollout", worker, incarnation, number)
    ledger.judge(sender, number)
    ledger.accept(sender, 10, number * 10, number * 10)
    history.add(Entry("accepted", worker, incarnation, number, number, 10, number * 10, number * 10))


@pytest.mark.parametrize("kept", range(6))
def test_what_was_acknowledged_after_the_checkpoint_is_lost_exactly(tmp_path, kept):
    """Whatever the cut, accepted and lost together are what had been acknowledged, before any worker comes back."""
    path, ledger = tmp_path / "learner.jsonl", Ledger()
    history = History(path)
    recover_losses(history, ledger, 1, resumed=False)
    saved = ledger.state()
    for number in range(1, 6):
        accepted(ledger, history, "a", number)
        if number == 3:
            accepted(ledger, history, "b", 1)
        if number == kept:
            saved = ledger.state()
    again = Ledger()
    again.restore(saved)
    lost = recover_losses(History(path), again, 2, resumed=True)
    totals = again.totals()
    assert totals["accepted"] + totals["lost"] == 60
    assert totals["lost"] == lost == 60 - Ledger.totals(again)["accepted"]
    assert totals["in_flight"] == 0
    assert again.judge(Envelope("rollout", "a", 1, 5), 5) == "duplicate"
    assert again.judge(Envelope("rollout", "a", 1, 6), 6) == "accepted"


def test_a_new_start_of_a_worker_after_the_checkpoint(tmp_path):
    """Chunks of a start that the checkpoint does not know are lost too, and its own are not forgotten."""
    path, ledger = tmp_path / "learner.jsonl", Ledger()
    history = History(path)
    recover_losses(history, ledger, 1, resumed=False)
    accepted(ledger, history, "a", 1)
    saved = ledger.state()
    accepted(ledger, history, "a", 2)
    accepted(ledger, history, "a", 1, incarnation=2)
    again = Ledger()
    again.restore(saved)
    assert recover_losses(History(path), again, 2, resumed=True) == 20
    assert (again.totals()["accepted"], again.totals()["lost"]) == (10, 20)
    assert again.workers["a"].incarnation == 2


def test_killed_twice_before_the_next_checkpoint(tmp_path):
    """A second kill before a new checkpoint books the losses of the first once more in the old ledger, not twice."""
    path, ledger = tmp_path / "learner.jsonl", Ledger()
    history = History(path)
    recover_losses(history, ledger, 1, resumed=False)
    accepted(ledger, history, "a", 1)
    saved = ledger.state()
    accepted(ledger, history, "a", 2)
    second, history = Ledger(), History(path)
    second.restore(saved)
    assert recover_losses(history, second, 2, resumed=True) == 10
    accepted(second, history, "a", 3)
    third = Ledger()
    third.restore(saved)
    assert recover_losses(History(path), third, 3, resumed=True) == 20
    assert third.totals()["produced"] == 30


def test_a_long_range_is_gone_through_from_where_the_checkpoint_ends(tmp_path):
    """What the checkpoint knows already is skipped at once, and only the rest is lost."""
    path, ledger = tmp_path / "learner.jsonl", Ledger()
    many = 2**24
    ledger.accept(Envelope("rollout", "a", 1, many - 1), 10, (many - 1) * 10, (many - 1) * 10)
    path.write_text(
        f'["start","learner","learner",1]\n["accepted","a",1,1,{many},10,{many * 10},{many * 10}]\n', encoding="utf-8"
    )
    history = History(path)
    assert len(history.before) == 2
    before = ledger.totals()["lost"]
    assert recover_losses(history, ledger, 2, resumed=True) == 10
    assert ledger.totals()["lost"] == before + 10


@pytest.mark.timeout(60)  # a loop over the chunks takes 83 s for a single line
def test_a_forged_line_of_many_chunks_takes_no_time(tmp_path):
    """Sixteen lines of 2^24 chunks each are booked as ranges; each line's chunks all count."""
    many = 2**24
    lines = [f'["accepted","w{index}",1,1,{many},10,{many * 10},{many * 10}]' for index in range(8)]
    lines += [f'["refused","r{index}",1,1,{many},10,{many * 10},{many * 10}]' for index in range(4)]
    lines += [f'["refused","n{index}",1,1,{many},0,0,0]' for index in range(4)]
    path, ledger = tmp_path / "learner.jsonl", Ledger()
    path.write_text("\n".join(lines) + "\n")
    assert recover_losses(History(path), ledger, 2, resumed=True) == 8 * 10 * many
    totals = ledger.totals()
    assert (totals["rejected"], totals["refused"], totals["aged"]) == (4 * 10 * many, 8 * many, 4 * many)
    assert {ledger.expected for ledger in ledger.workers.values()} == {many + 1}
    assert ledger.unexplained() == 0


def booked_one_by_one(ledger, entry):
    """Book an entry's chunks singly, in order."""
    known = ledger.workers.get(entry.worker)
    for number in range(max(entry.first, known.expected if known else 0), entry.last + 1):
        sender = Envelope("rollout", entry.worker, entry.incarnation, number)
        behind = (entry.last - number) * entry.steps
        counts = entry.steps, entry.produced - behind, max(0, entry.flown - behind)
        if entry.verdict == "accepted":
            ledger.lose(sender, *counts)
        elif entry.produced:
            ledger.refuse_aged(sender, *counts)
        else:
            ledger.refuse(sender)


@pytest.mark.parametrize("seed", range(40))
def test_chunks_booked_at_once_count_as_chunks_booked_one_by_one(seed):
    """Random histories with gaps, refusals and overlaps give the same account of every worker."""
    draw = random.Random(seed)
    at_once, singly = Ledger(), Ledger()
    number, produced = 1, 0
    for _ in range(30):
        number += draw.choice([0, 0, 0, 3])
        count, steps = draw.randint(1, 6), draw.choice([5, 10])
        produced += draw.choice([0, 0, steps]) + count * steps
        unknown = draw.random() < 0.3
        verdict = "refused" if unknown else draw.choice(["accepted", "accepted", "refused"])
        counts = (0, 0, 0) if unknown else (steps, produced, produced + draw.choice([0, 7]))
        entry = Entry(verdict, "w", 1, number, number + count - 1, *counts)
        number += count - draw.choice([0, 0, 1])
        recovery._book(at_once, entry)
        booked_one_by_one(singly, entry)
        assert at_once.workers == singly.workers
    assert at_once.totals()["produced"] > 0
