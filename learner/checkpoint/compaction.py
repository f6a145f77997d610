"""Compacts the learner's history: sums up records that precede every kept checkpoint."""

from collections import deque
from typing import Final

from eia_sec.common.history.history import History
from eia_sec.common.history.summary import Marks, summarised
from eia_sec.learner.intake.ledger import LedgerSnapshot

MOST_RECORDS: Final = 20_000
"""Number of records (some megabytes) above which totals replace those before all checkpoints."""


class HistoryCompaction:
    """Keeps a learner's history short.

    Args:
        history: the learner's.
        kept: number of checkpoints that are kept.
    """

    def __init__(self, history: History, kept: int) -> None:
        self._history = history
        # While the newest is still being written, one more of the older ones exists.
        self._marks: deque[Marks] = deque(maxlen=kept + 2)

    def on_checkpoint(self, ledger: LedgerSnapshot, *, failed: bool) -> None:
        """Sum up the records before all kept checkpoints, if the history is long; call it once for each checkpoint.

        Args:
            ledger: the ledger of the checkpoint that is being written.
            failed: whether the previous checkpoint could not be written; it is then unknown which ones exist.
        """
        if failed:
            self._marks.clear()
        self._marks.append({name: (worker.incarnation, worker.expected) for name, worker in ledger.workers.items()})
        if self._history.records > MOST_RECORDS and len(self._marks) == self._marks.maxlen:
            oldest = self._marks[0]
            self._history.rewrite(lambda records: summarised(records, oldest))
