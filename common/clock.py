"""The clocks by which processes act together. Code reads them here, so that a simulation can set them."""

import time
from typing import Protocol


class Clock(Protocol):
    """Where the time comes from; the module `time` is one."""

    def monotonic(self) -> float:
        """Return seconds that never go back."""

    def time_ns(self) -> int:
        """Return nanoseconds since 1970, as the machine's clock is set."""


source: Clock = time


def monotonic() -> float:
    """Return seconds that never go back."""
    return source.monotonic()


def microseconds() -> int:
    """Return microseconds since 1970, as the machine's clock is set."""
    return source.time_ns() // 1000
