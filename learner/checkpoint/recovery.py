"""What the learner's history says beyond the checkpoint that it resumes from: acknowledged, and lost with it."""

from common.history import Entry, History, Resume, Start
from common.protocol.messages import Envelope
from learner.intake.ledger import Intake


def recover_losses(history: History, intake: Intake, epoch: int, *, resumed: bool) -> int:
    """Begin a start of the learner in its history, and book what an earlier one had accepted too late to keep it.

    A chunk that was acknowledged after the last checkpoint does not come again, because its worker has let go of it.
    It is lost, and is booked as that here, rather than when its worker next delivers, which may be never.

    Args:
        history: the learner's own.
        intake: the ledger of the checkpoint, or an empty one; the losses are booked in it.
        epoch: this start's fencing epoch.
        resumed: whether this start goes on with an earlier one.

    Returns:
        the environment steps that are lost in this way.
    """
    history.add(Start("learner", "learner", epoch))
    if not resumed:
        return 0
    history.add(Resume({name: (ledger.incarnation, ledger.expected) for name, ledger in intake.workers.items()}))
    before = intake.totals()["lost"]
    for record in history.before:
        if isinstance(record, Entry) and record.verdict in ("accepted", "refused"):
            _book(intake, record)
    return intake.totals()["lost"] - before


def _book(intake: Intake, entry: Entry) -> None:
    known = intake.workers.get(entry.worker)
    if known is not None and entry.incarnation < known.incarnation:
        return
    first = max(entry.first, known.expected if known is not None and entry.incarnation == known.incarnation else 0)
    for number in range(first, entry.last + 1):
        sender = Envelope("rollout", entry.worker, entry.incarnation, number)
        behind = (entry.last - number) * entry.steps
        produced, flown = entry.produced - behind, max(0, entry.flown - behind)
        if entry.verdict == "accepted":
            intake.lose(sender, entry.steps, produced, flown)
        elif entry.produced:
            intake.refuse_aged(sender, entry.steps, produced, flown)
        else:
            intake.refuse(sender)
