"""Between the source and the browsers: the recent past for those who come later, and a bounded queue for each."""

import threading
from collections import deque
from typing import Final

from deploy.monitor.web.packets import Packet

HISTORY_FRAMES: Final = 2048
"""Frames that are kept for browsers that come later; the page keeps as many."""
HISTORY_BYTES: Final = 64 * 2**20
"""Bytes that they may take."""
QUEUE_BYTES: Final = 16 * 2**20
"""Bytes that may wait for a browser which is slow; then the oldest frames are dropped. One packet always may."""


class Seat:
    """What waits for one browser.

    Attributes:
        dropped: frames that this browser was too slow for.
    """

    def __init__(self, packets: list[Packet]) -> None:
        self._waiting = deque(packets)
        self._bytes = sum(len(packet.data) for packet in packets)
        self._changed = threading.Condition()
        self.dropped = 0

    def put(self, packet: Packet) -> None:
        """Let a packet wait; drop the oldest ones when there are too many."""
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
        """Return the next packet, or None when none comes in that time."""
        with self._changed:
            if not self._waiting and not self._changed.wait(seconds):
                return None
            packet = self._waiting.popleft()
            self._bytes -= len(packet.data)
            return packet


class Hub:
    """Hands packets to every browser; from the source's thread to those of the connections."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._seats: set[Seat] = set()
        self._scene: Packet | None = None
        self._history: deque[Packet] = deque()
        self._state: Packet | None = None

    @property
    def seats(self) -> int:
        """Return how many browsers look."""
        with self._lock:
            return len(self._seats)

    def enter(self, most: int) -> Seat | None:
        """Return a seat with everything that a browser needs to begin, or None when there are `most` already."""
        with self._lock:
            if len(self._seats) >= most:
                return None
            seat = Seat([packet for packet in (self._scene, *self._history, self._state) if packet is not None])
            self._seats.add(seat)
            return seat

    def leave(self, seat: Seat) -> None:
        """Give a seat back."""
        with self._lock:
            self._seats.discard(seat)

    def begin(self, scene: Packet) -> None:
        """Begin anew with another worker or farm; what was kept of the one before is forgotten."""
        with self._lock:
            self._scene = scene
            self._history.clear()
            self._hand_out(scene)

    def show(self, frames: Packet) -> None:
        """Hand out frames, and keep them for browsers that come later."""
        with self._lock:
            self._history.append(frames)
            while len(self._history) > 1 and (
                sum(packet.frames for packet in self._history) > HISTORY_FRAMES
                or sum(len(packet.data) for packet in self._history) > HISTORY_BYTES
            ):
                self._history.popleft()
            self._hand_out(frames)

    def tell(self, state: Packet) -> None:
        """Hand out how things stand."""
        with self._lock:
            self._state = state
            self._hand_out(state)

    def _hand_out(self, packet: Packet) -> None:
        for seat in self._seats:
            seat.put(packet)
