"""The learner's fencing epoch, which is the incarnation of its start: each later start of a run's has a higher one."""

from eia_sec.common.errors import ProtocolError
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import ProgressMessage
from eia_sec.common.transport.bus import Bus


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
