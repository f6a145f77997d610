"""Which learner a process follows when learners with different epochs speak for one run.

A learner that starts later has a higher epoch, so whoever follows it ignores the one that it replaced. A learner that
kept no run directory and whose clock was set back has a lower epoch than the one before it. It must not be ignored for
ever: when only it speaks, it is followed after a while.
"""

import time
from collections.abc import Callable
from typing import Final

from common.process import log

PATIENCE_SECONDS: Final = 10.0
"""Time for which only a lower epoch speaks before it is followed; a replaced learner ends long before."""


class EpochFence:
    """Admits messages of the followed learner and of later ones.

    Args:
        clock: monotonic seconds.

    Attributes:
        alarm: that a learner with a lower epoch is being ignored, or empty.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
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
            self.alarm = (
                "a learner with a lower epoch than the one that is followed is ignored; was its clock set back?"
            )
            if epoch != self._logged:
                log(self.alarm)
                self._logged = epoch
        if now - self._lower_since < PATIENCE_SECONDS:
            return False
        log(f"nothing was heard of the learner with epoch {followed}; following the one with epoch {epoch}.")
        self._lower_since, self.alarm = None, ""
        return True
