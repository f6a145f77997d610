"""Refusals that are delayed, so that a peer that waits for its answers cannot flood the learner."""

import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from common.transport.bus import Incoming

HOLD_SECONDS: Final = 5.0
"""Delay of a refusal, s; less than a worker's patience, so that it learns the reason."""
MOST_HELD: Final = 256
"""Most requests that are held; beyond them the oldest is refused at once."""
MOST_BYTES: Final = 32 * 2**20
"""Most bytes that they may take, likewise."""
LEAST_BYTES: Final = 65_536
"""Least bytes of one request: the receive buffer that Zenoh keeps for it."""


@dataclass(frozen=True)
class _Held:
    due: float
    incoming: Incoming
    reason: str
    size: int


class Throttle:
    """Holds refused requests for a while; any thread may call.

    Attributes:
        turned_away: requests that were ever held.

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
        """Hold a request, to be refused later; its payload is dropped."""
        size = max(LEAST_BYTES, len(incoming.payload))
        incoming.payload = b""
        with self._lock:
            self.turned_away += 1
            self._bytes += size
            self._held.append(_Held(self._clock() + HOLD_SECONDS, incoming, reason, size))
        self.release()

    def release(self) -> None:
        """Refuse the requests that are due, and the oldest while too much is held."""
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
