"""Which learner a process follows when learners with different epochs send messages for one run.

A later learner has a higher epoch, so its followers ignore the learner that it replaced. A learner without a run
directory on a machine whose clock was set back has a lower epoch than its predecessor. If it is the only one that
sends, processes follow it after a while.
"""

from collections.abc import Callable
from typing import Final

from eia_sec.common.clock import monotonic
from eia_sec.common.log import log

PATIENCE_SECONDS: Final = 10.0
"""Time for which only a lower epoch must send before it is followed, s; a replaced learner ends much sooner."""


class EpochFence:
    """Admits messages of the followed learner and of later ones.

    Args:
        clock: monotonic seconds.

    Attributes:
        alarm: a sentence while a learner with a lower epoch is ignored, else empty.
    """

    def __init__(self, clock: Callable[[], float] = monotonic) -> None:
        self._clock = clock
        self._lower_since: float | None = None
        self._logged = 0
        self.alarm = ""

    def admits(self, epoch: int, followed: int) -> bool:
        """Return whether to follow the sender of a message.

        Args:
            epoch: the sender's fencing epoch.
            followed: the epoch that is followed now; 0 for none.
        """
        if epoch >= followed:
            self._lower_since, self.alarm = None, ""
            return True
        now = self._clock()
        if self._lower_since is None:
            self._lower_since = now
            self.alarm = "a learner with a lower epoch than the followed one is ignored; was its clock set back?"
            if epoch != self._logged:
                log(self.alarm)
                self._logged = epoch
        if now - self._lower_since < PATIENCE_SECONDS:
            return False
        log(f"the learner with epoch {followed} is silent; following the one with epoch {epoch}.")
        self._lower_since, self.alarm = None, ""
        return True
