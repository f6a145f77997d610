"""Refusals that are held back: whoever floods waits for the answers, and asks again only so often."""

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from common.transport.bus import Incoming

HOLD_SECONDS: Final = 5.0
"""Time for which a refusal is held back; less than a worker's patience, so that it learns the reason."""
MOST_HELD: Final = 256
"""Requests that are held at most; beyond them the oldest is refused at once."""
MOST_BYTES: Final = 32 * 2**20
"""The same for the memory that they take."""
LEAST_BYTES: Final = 65_536
"""What one request takes at least: the receive buffer that Zenoh keeps for it."""


@dataclass(frozen=True)
class _Held:
    due: float
    incoming: Incoming
    reason: str
    size: int


class Throttle:
    """Requests whose refusal is decided and waits; any thread may call.

    Attributes:
        turned_away: requests that were ever put here.

    Args:
        clock: seconds; for tests.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self.turned_away = 0
        self._clock = clock
        self._held: deque[_Held] = deque()
        self._bytes = 0
        self._lock = threading.Lock()

    def hold(self, incoming: Incoming, reason: str) -> None:
        """Hold a request back, to be refused later; nobody may read its payload any more."""
        size = max(LEAST_BYTES, len(incoming.payload))
        incoming.payload = b""
        with self._lock:
            self.turned_away += 1
            self._bytes += size
            self._held.append(_Held(self._clock() + HOLD_SECONDS, incoming, reason, size))
        self.release()

    def release(self) -> None:
        """Refuse what has been held long enough, and the oldest as long as too much is held."""
        while (held := self._next()) is not None:
            held.incoming.refuse(held.reason)

    def _next(self) -> _Held | None:
        with self._lock:
            if not self._held:
                return None
            full = len(self._held) > MOST_HELD or self._bytes > MOST_BYTES
            if not full and self._clock() < self._held[0].due:
                return None
            held = self._held.popleft()
            self._bytes -= held.size
            return held
