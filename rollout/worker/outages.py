"""Waits while an environment's simulator or robot is away."""

from threading import Event
from typing import Final

from eia_sec.common.errors import CancelledError
from eia_sec.common.log import log

FIRST_SECONDS: Final = 1.0
LONGEST_SECONDS: Final = 60.0
"""Pauses between two tries: the first, and the longest of those that follow, each twice as long as the one before."""


class Outages:
    """Counts outages, and pauses before each try to end one; it is what `eia_sec.rollout.envs.base.Patience` asks for.

    Args:
        stop: ends a pause, and the wait.

    Attributes:
        count: outages so far.
    """

    def __init__(self, stop: Event) -> None:
        self._stop = stop
        self.count = self._running = 0
        self._said = ""

    @property
    def alarm(self) -> str:
        """A sentence about the running outage, or an empty string."""
        return f"the environment is away: {self._said}; outage {self.count}." if self._running else ""

    def begin(self, said: str) -> None:
        """Count an outage, of which the environment says this."""
        self.count += 1
        self._running += 1
        self._said = said
        log(self.alarm)

    def pause(self, failed: int) -> None:
        """Pause after so many failed tries in a row; raise CancelledError when the process ends."""
        seconds = min(LONGEST_SECONDS, FIRST_SECONDS * 2.0 ** min(failed - 1, 30))
        log(f"the environment is still away after {failed} {'try' if failed == 1 else 'tries'}; next in {seconds:g} s.")
        if self._stop.wait(seconds):
            raise CancelledError("the environment is away, and this process ends.")

    def over(self) -> None:
        """Note that an environment answers again."""
        self._running -= 1
        log("the environment is back.")
