"""A learner's history stays small whatever workers send; its totals and every loss stay."""

from pathlib import Path

import pytest

from eia_sec.common.history.history import Entry, History, Record, Resume, Start, Summary, parse, read, text
from eia_sec.common.history.summary import MOST_STARTS, summarised
from eia_sec.deploy.monitor.audit import audit
from eia_sec.learner.checkpoint import compaction
from eia_sec.learner.checkpoint.compaction import HistoryCompaction
from eia_sec.learner.intake.ledger import Ledger, LedgerSnapshot, WorkerLedger


def entry(verdict: str, first: int, last: int, steps: int = 10, start: int = 1) -> Entry:
    return Entry(verdict, "w", start, first, last, steps, last * 10, last * 10)


def ledger(start: int, expected: int) -> LedgerSnapshot:
    return LedgerSnapshot(Ledger().closed, {"w": WorkerLedger(start, expected)})


def test_a_summary_comes_back_from_its_line():
    """A summary and the record of its line are equal, and impossible totals are no record."""
    summary = Summary("w", 3, 7, accepted=5, accepted_steps=50, refused=2, duplicates=1)
    assert parse(text(summary)) == summary
    with pytest.raises(ValueError, match="number"):
        parse(text(summary).replace("50", "-50"))


def test_chunks_before_the_mark_become_totals():
    """An entry that the mark cuts is summed up to there, and goes on as a line from there."""
    records: list[Record] = [
        Start("learner", "learner", 1),
        entry("missing", 3, 3, 20),
        entry("accepted", 3, 8),
        entry("refused", 9, 9, 0),
        entry("duplicate", 4, 5, 3),
        entry("accepted", 10, 20),
    ]
    summary = Summary("w", 1, 14, 11, 110, refused=1, missing_steps=20, duplicates=3)
    assert summarised(records, {"w": (1, 15)}) == [records[0], summary, entry("accepted", 15, 20)]
    assert summarised(summarised(records, {"w": (1, 10)}), {"w": (1, 15)})[1] == summary
    assert summarised(records, {}) == [records[0], *records[1:]]


def test_what_a_resume_rolled_back_stays_lost():
    """Chunks that the checkpoint of a resume did not hold are lost in the totals, too."""
    records = [entry("accepted", 1, 30), Resume({"w": (1, 21)}), entry("accepted", 31, 40)]
    assert summarised(records, {"w": (1, 41)}) == [Summary("w", 1, 40, 30, 300, lost=10, lost_steps=100)]


def test_what_a_replaced_start_never_delivered_stays_lost(tmp_path):
    """Its steps are in the totals once, also when a learner that was killed wrote them twice."""
    undelivered = entry("undelivered", 3, 3, 30)
    told_again = [undelivered, Resume({"w": (1, 3)}), undelivered]
    found = summarised([entry("accepted", 1, 2), *told_again, entry("accepted", 1, 9, start=2)], {"w": (2, 5)})
    assert found[:1] == [Summary("w", 1, 2, 2, 20, undelivered_steps=30)]
    history = History(tmp_path / "history" / "learner.jsonl")
    for record in [Start("learner", "learner", 1), *found]:
        history.add(record)
    history.close()
    assert audit(tmp_path).lost_with["unknown"] == 30


def test_a_second_resume_may_be_from_an_older_checkpoint():
    """Where the newest checkpoint was damaged, chunks that the first resume still held are lost with the second."""
    records = [entry("accepted", 1, 30), Resume({"w": (1, 31)}), Resume({"w": (1, 21)}), entry("accepted", 31, 40)]
    assert summarised(records, {"w": (1, 41)}) == [Summary("w", 1, 40, 30, 300, lost=10, lost_steps=100)]


def test_starts_without_end_share_a_line():
    """Of a worker's starts the newest have a line each, and no step of the others is dropped."""
    records = [entry("accepted", 1, 2, start=start) for start in range(1, 501)]
    found = summarised(records, {"w": (501, 1)})
    assert len(found) == MOST_STARTS
    assert sum(part.accepted_steps for part in found if isinstance(part, Summary)) == 500 * 20


def alternate(path: Path, chunks: int, every: int) -> tuple[History, Ledger]:
    """Accept and refuse chunks in turn, with a checkpoint every so many; return the history and the ledger."""
    history, kept = History(path), Ledger()
    compacted = HistoryCompaction(history, kept=2)
    for number in range(1, chunks + 1):
        history.add(entry("accepted" if number % 2 else "refused", number, number, 10))
        if number % every == 0:
            compacted.on_checkpoint(ledger(1, number + 1), failed=False)
    return history, kept


def test_chunks_that_never_join_do_not_grow_a_history_without_end(tmp_path, monkeypatch):
    """However long chunks alternate, file and memory keep to what lies behind the kept checkpoints."""
    monkeypatch.setattr(compaction, "MOST_RECORDS", 100)
    sizes = []
    for chunks in (1_000, 4_000):
        path = tmp_path / str(chunks) / "history" / "learner.jsonl"
        history, _ = alternate(path, chunks, every=50)
        history.close()
        sizes.append(len(path.read_text().splitlines()))
        found = audit(tmp_path / str(chunks))
        assert found.clean, found.named()
        assert (found.steps["accepted"], found.steps["rejected"]) == (chunks * 5, chunks * 5)
        assert found.summed >= chunks - 5 * 50
    assert max(sizes) <= 5 * 50 + 2


def test_a_worker_whose_learner_sums_up_is_still_audited(tmp_path, monkeypatch):
    """Its single lines behind the sum are compared, those before are in the totals once."""
    monkeypatch.setattr(compaction, "MOST_RECORDS", 100)
    history, _ = alternate(tmp_path / "history" / "learner.jsonl", 1_000, every=50)
    history.close()
    worker = History(tmp_path / "history" / "rollout-w.jsonl")
    worker.add(Start("rollout", "w", 1))
    for number in range(1, 1_001):
        worker.add(entry("produced", number, number))
        worker.add(entry("acknowledged" if number % 2 else "refused", number, number))
    worker.add(entry("produced", 1_001, 1_001))
    worker.close()
    found = audit(tmp_path)
    assert found.clean, found.named()
    assert (found.steps["accepted"], found.steps["rejected"], found.steps["lost"]) == (5_000, 5_000, 10)


def test_a_checkpoint_that_failed_keeps_all_lines(tmp_path, monkeypatch):
    """While nobody knows which checkpoint a resume begins with, nothing is summed up."""
    monkeypatch.setattr(compaction, "MOST_RECORDS", 10)
    history = History(tmp_path / "learner.jsonl")
    compacted = HistoryCompaction(history, kept=2)
    for number in range(1, 101):
        history.add(entry("accepted" if number % 2 else "refused", number, number, 10))
        compacted.on_checkpoint(ledger(1, number + 1), failed=number % 3 == 0)
    history.close()
    assert not any(isinstance(record, Summary) for record in read(tmp_path / "learner.jsonl")[0])
