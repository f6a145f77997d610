"""Waits while an environment's simulator or robot is away."""

from threading import Event
from typing import Final

from eia_sec.common.errors import CancelledError
from eia_sec.common.log import log

FIRST_SECONDS: Final = 1.0
LONGEST_SECONDS: Final = 60.0
"""Pauses between two tries: the first, and the longest of those that follow, each twice as long as the one before."""


class Outages:
    """Counts outages, and pauses before each try to end one.

    Args:
        stop: ends a pause, and the wait.

    Attributes:
        count: outages so far.
        alarm: what the environment says of the present outage, or an empty string.
    """

    def __init__(self, stop: Event) -> None:
        self._stop = stop
        self.count = 0
        self._said, self._until = "", 0.0

    @property
    def alarm(self) -> str:
        """A sentence about the running outage, or an empty string."""
        return f"{self._said}; outage {self.count}." if self._said else ""

    def wait(self, said: str, failed: int) -> None:
        """Note an outage, or pause after a failed try to end it.

        Args:
            said: what the environment says of it.
            failed: tries that have failed; 0 for the step in which the outage began.

        Raises:
            CancelledError: the process ends.
        """
        if failed <= 1 and not self._said:
            self.count += 1
            log(f"the environment is away: {said}")
        self._said = f"the environment is away: {said}"
        if failed and self._stop.wait(min(LONGEST_SECONDS, FIRST_SECONDS * 2.0 ** (failed - 1))):
            raise CancelledError("the environment is away, and this process ends.")

    def over(self) -> None:
        """Note that the environment answers again."""
        if self._said:
            log("the environment is back.")
        self._said = ""
