"""Delays refusals, so that a peer that waits for its answers cannot flood the learner."""

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from eia_sec.common.clock import monotonic
from eia_sec.common.transport.bus import Incoming

HOLD_SECONDS: Final = 5.0
"""Delay of a refusal, s; less than a worker's time limit, so that the reason reaches it."""
MOST_HELD: Final = 256
"""Most requests held; beyond that, the oldest is refused at once."""
MOST_BYTES: Final = 32 * 2**20
"""Most bytes held; beyond that, the oldest request is refused at once."""
LEAST_BYTES: Final = 65_536
"""Least bytes that one request counts as: the receive buffer that Zenoh keeps for it."""


@dataclass(frozen=True)
class _Held:
    due: float
    incoming: Incoming
    reason: str
    size: int


class Throttle:
    """Holds refused requests for a while; any thread may call.

    Attributes:
        turned_away: number of requests held so far.

    Args:
        clock: returns monotonic seconds; tests replace it.
    """

    def __init__(self, clock: Callable[[], float] = monotonic) -> None:
        self.turned_away = 0
        self._clock = clock
        self._held: deque[_Held] = deque()
        self._bytes = 0
        self._lock = threading.Lock()

    def hold(self, incoming: Incoming, reason: str) -> None:
        """Hold a request, drop its payload, and refuse it later."""
        size = max(LEAST_BYTES, len(incoming.payload))
        incoming.payload = b""
        with self._lock:
            self.turned_away += 1
            self._bytes += size
            self._held.append(_Held(self._clock() + HOLD_SECONDS, incoming, reason, size))
        self.release()

    def release(self) -> None:
        """Refuse the requests that are due, and the oldest ones while too many are held."""
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
