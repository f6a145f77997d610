"""The learner's fencing epoch: each later start of a run's learner has a higher one."""

from eia_sec.common.errors import ProtocolError
from eia_sec.common.incarnation import new_incarnation
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import ProgressMessage
from eia_sec.common.transport.bus import Bus


def next_epoch(last: int) -> int:
    """Return the epoch of a new start of the learner.

    It is the incarnation of this start, see `eia_sec.common.incarnation`. It grows even if the clock was set back, and
    two copies of one run directory start with different epochs.

    Args:
        last: the highest epoch known from the checkpoint and the history; 0 for none.
    """
    return new_incarnation(last)


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
