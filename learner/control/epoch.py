"""The learner's fencing epoch: a number that is higher for every later start."""

from common.errors import ProtocolError
from common.protocol import keys
from common.protocol.messages import ProgressMessage
from common.transport.bus import Bus


class SuccessorWatch:
    """Notices a learner of the same run with a higher epoch, which has taken this one's place.

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
