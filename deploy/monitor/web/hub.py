"""Between the source and the browsers: recent frames for newcomers, and a bounded queue for each browser."""

import threading
from collections import deque
from typing import Final

from eia_sec.deploy.monitor.web.packets import Packet

HISTORY_FRAMES: Final = 2048
"""Most frames that are kept for browsers that connect later; the page keeps as many."""
HISTORY_BYTES: Final = 64 * 2**20
"""Most bytes of these frames."""
QUEUE_BYTES: Final = 16 * 2**20
"""Most bytes that wait for a slow browser; then the oldest frames are dropped. One packet is always allowed."""


class Seat:
    """The queue of one browser.

    Attributes:
        dropped: frames that were dropped because this browser was slow.
    """

    def __init__(self, packets: list[Packet]) -> None:
        self._waiting = deque(packets)
        self._bytes = sum(len(packet.data) for packet in packets)
        self._changed = threading.Condition()
        self.dropped = 0

    def put(self, packet: Packet) -> None:
        """Add a packet; drop the oldest frames when the queue is full."""
        with self._changed:
            self._waiting.append(packet)
            self._bytes += len(packet.data)
            while self._bytes > QUEUE_BYTES and len(self._waiting) > 1:
                oldest = next((held for held in self._waiting if held.frames), self._waiting[0])
                self._waiting.remove(oldest)
                self._bytes -= len(oldest.data)
                self.dropped += oldest.frames
            self._changed.notify()

    def take(self, seconds: float) -> Packet | None:
        """Return the next packet, or None if none arrives in that time."""
        with self._changed:
            if not self._waiting and not self._changed.wait(seconds):
                return None
            packet = self._waiting.popleft()
            self._bytes -= len(packet.data)
            return packet


class Hub:
    """Passes packets from the source's thread to the threads of all connections.

    Attributes:
        wanted: the worker that a browser has asked to see, until the source has looked whether it lives.
    """

    def __init__(self) -> None:
        self.wanted: str | None = None
        self._lock = threading.Lock()
        self._seats: set[Seat] = set()
        self._scene: Packet | None = None
        self._history: deque[Packet] = deque()
        self._state: Packet | None = None

    @property
    def seats(self) -> int:
        """Return the number of connected browsers."""
        with self._lock:
            return len(self._seats)

    def enter(self, most: int) -> Seat | None:
        """Return a queue with all that a new browser needs, or None if there are `most` browsers already."""
        with self._lock:
            if len(self._seats) >= most:
                return None
            seat = Seat([packet for packet in (self._scene, *self._history, self._state) if packet is not None])
            self._seats.add(seat)
            return seat

    def leave(self, seat: Seat) -> None:
        """Remove a browser's queue."""
        with self._lock:
            self._seats.discard(seat)

    def begin(self, scene: Packet) -> None:
        """Start over with another worker or farm; the recent frames of the previous one are dropped."""
        with self._lock:
            self._scene = scene
            self._history.clear()
            self._send(scene)

    def show(self, frames: Packet) -> None:
        """Send frames to all browsers, and keep them for browsers that connect later."""
        with self._lock:
            self._history.append(frames)
            while len(self._history) > 1 and (
                sum(packet.frames for packet in self._history) > HISTORY_FRAMES
                or sum(len(packet.data) for packet in self._history) > HISTORY_BYTES
            ):
                self._history.popleft()
            self._send(frames)

    def report(self, state: Packet) -> None:
        """Send the state to all browsers."""
        with self._lock:
            self._state = state
            self._send(state)

    def _send(self, packet: Packet) -> None:
        for seat in self._seats:
            seat.put(packet)
