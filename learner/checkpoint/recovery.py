"""Finds the chunks that a resumed learner had accepted after its checkpoint, and counts them as lost.

A worker drops a chunk once it is acknowledged. So a chunk that the learner accepted after its last checkpoint never
arrives again. It is booked as lost here, not at the worker's next delivery, which may never happen.
"""

from collections.abc import Iterable

from eia_sec.common.history.history import Entry, History, Record, Resume, Start
from eia_sec.common.protocol.messages import Envelope
from eia_sec.learner.intake.ledger import Ledger


def last_epoch(records: Iterable[Record]) -> int:
    """Return the highest epoch of a learner in a history, or 0."""
    starts = (r.incarnation for r in records if isinstance(r, Start) and r.role == "learner")
    return max(starts, default=0)


def recover_losses(history: History, ledger: Ledger, epoch: int, *, resumed: bool) -> int:
    """Record a start of the learner in its history, and book as lost what was accepted after the checkpoint.

    Args:
        history: the learner's own.
        ledger: the ledger of the checkpoint, or an empty one; the losses are booked in it.
        epoch: this start's fencing epoch.
        resumed: whether this start continues an earlier one.

    Returns:
        The environment steps lost in this way.
    """
    history.add(Start("learner", "learner", epoch))
    if not resumed:
        return 0
    history.add(Resume({name: (worker.incarnation, worker.expected) for name, worker in ledger.workers.items()}))
    before = ledger.totals()["lost"]
    for record in history.before:
        if isinstance(record, Entry) and record.verdict in ("accepted", "refused"):
            _book(ledger, record)
    return ledger.totals()["lost"] - before


def _book(ledger: Ledger, entry: Entry) -> None:
    """Book the chunks of an entry that the ledger does not know yet, in constant time."""
    known = ledger.workers.get(entry.worker)
    if known is not None and entry.incarnation < known.incarnation:
        return
    first = max(entry.first, known.expected if known is not None and entry.incarnation == known.incarnation else 0)
    if first > entry.last:
        return
    # Only the first chunk can follow a gap. The others continue its counts, so they are booked at once.
    _book_chunks(ledger, entry, first, first)
    if first < entry.last:
        _book_chunks(ledger, entry, first + 1, entry.last)


def _book_chunks(ledger: Ledger, entry: Entry, first: int, last: int) -> None:
    """Book chunks `first` to `last` of an entry at once."""
    chunks, behind = last - first + 1, (entry.last - last) * entry.steps
    steps, produced, flown = chunks * entry.steps, entry.produced - behind, max(0, entry.flown - behind)
    sender = Envelope("rollout", entry.worker, entry.incarnation, last)
    if entry.verdict == "accepted":
        ledger.lose(sender, steps, produced, flown)
    elif entry.produced:
        ledger.refuse_aged(sender, steps, produced, flown, chunks)
    else:
        ledger.refuse(sender, chunks)
