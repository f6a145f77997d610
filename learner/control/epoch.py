"""The learner's fencing epoch: a number that is higher for every later start of a run's learner."""

import secrets
from typing import Final

from common.errors import ProtocolError
from common.process import incarnation
from common.protocol import keys
from common.protocol.messages import ProgressMessage
from common.transport.bus import Bus

MOST_EPOCH: Final = 2**62
"""Epochs from here on are refused where they are read: no clock shows them, and later starts need higher ones."""
SPREAD: Final = 2**20
"""A start whose clock is behind takes one of so many epochs above the last one known."""


def next_epoch(last: int) -> int:
    """Return the epoch of a new start of the learner.

    It is the wall clock in microseconds, unless the clock is behind the last epoch; then it is a little above that, by
    a random amount, so that two copies of one run directory do not start with the same epoch.

    Args:
        last: the highest epoch known from the checkpoint and the history; 0 for none.
    """
    now = incarnation()
    return now if now > last else last + 1 + secrets.randbelow(SPREAD)


class SuccessorWatch:
    """Notices a learner of the same run with a higher epoch, which has replaced this one.

    Args:
        bus: the control lane.
        run: the run's name.
        epoch: this learner's fencing epoch.
    """

    def __init__(self, bus: Bus, run: str, epoch: int) -> None:
        self._progress = bus.subscribe_state(keys.PROGRESS.key(run))
        self._epoch = epoch

    def replaced(self) -> bool:
        """Return whether progress of a higher epoch has arrived."""
        try:
            sample = self._progress.poll()
            return sample is not None and ProgressMessage.decode(sample.payload).epoch > self._epoch
        except ProtocolError:
            return False
