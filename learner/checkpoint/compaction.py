"""When the learner's history may be summed up: never what a checkpoint that is kept could be resumed from."""

from collections import deque
from typing import Final

from common.history.history import History
from common.history.summary import Marks, summarised
from learner.intake.ledger import LedgerSnapshot

MOST_RECORDS: Final = 20_000
"""Records from which on those before all checkpoints become totals: some megabytes."""


class HistoryCompaction:
    """Keeps a learner's history short.

    Args:
        history: the learner's.
        kept: checkpoints that are kept.
    """

    def __init__(self, history: History, kept: int) -> None:
        self._history = history
        # The newest may still be being written, and then one more of the older ones is there.
        self._marks: deque[Marks] = deque(maxlen=kept + 2)

    def on_checkpoint(self, ledger: LedgerSnapshot, *, failed: bool) -> None:
        """Sum up what is before all checkpoints, when there is much of it.

        Args:
            ledger: the ledger of the checkpoint that is being written.
            failed: whether the one before could not be written; nothing is known then of which ones are kept.
        """
        if failed:
            self._marks.clear()
        self._marks.append({name: (worker.incarnation, worker.expected) for name, worker in ledger.workers.items()})
        if self._history.records > MOST_RECORDS and len(self._marks) == self._marks.maxlen:
            oldest = self._marks[0]
            self._history.rewrite(lambda records: summarised(records, oldest))
