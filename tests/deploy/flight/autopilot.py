"""An autopilot that keeps the rules of Offboard and Guided: what a bridge is tested against. It has never flown.

PX4: Offboard may be entered once a stream of 2 Hz has come for a second, and is left half a second after it ends; then
the vehicle loiters, and goes back to Offboard by itself when a stream is there again. ArduPilot: Guided holds, and the
vehicle stops 3 seconds after the last set-point. Both follow set-points only where they are armed and in that mode.
"""

import math

ACCELERATION = 5.0
STREAM_GAP = 0.5
"""Longest pause in a stream of 2 Hz, s."""


class FakeAutopilot:
    """One vehicle, moved by `turn`; its protocol is a subclass's.

    Args:
        clock: seconds that never go back.
        height: at the beginning, m.
        mode: likewise.

    Attributes:
        mute: whether it keeps its position for itself.
        frozen: whether its positions' time stands still.
        broken: whether its positions are no numbers.
        failsafe: whether it loiters by itself in the place of Offboard.
    """

    def __init__(self, clock, height, mode):
        self._clock, self.mode, self.armed, self.frozen = clock, mode, False, False
        self.place, self.velocity, self.wanted, self.yaw = [0.0, 0.0, -height], [0.0] * 3, [0.0] * 3, 0.0
        self._begin = self._last = clock()
        self.seconds = 1e-3
        self.mute = self.broken = self.failsafe = False
        self._gap_since = self._latest = -math.inf
        self.accepted, self.rejected, self.failsafes = 0, [], 0

    def pilot_sets_mode(self, mode) -> bool:
        """Let the pilot choose a mode; return whether the autopilot takes it."""
        now = self._clock()
        streams = now - self._latest <= STREAM_GAP and now - self._gap_since >= 1.0
        if mode == "OFFBOARD" and not streams:
            return False
        self.mode, self.failsafe = mode, False
        return True

    def turn(self):
        """Read, move and tell."""
        now = self._clock()
        self.read()
        streams = now - self._latest <= STREAM_GAP
        if self.mode == "OFFBOARD" and not streams:
            self.mode, self.failsafe, self.failsafes = "LOITER", True, self.failsafes + 1
        elif self.failsafe and streams:
            self.mode, self.failsafe = "OFFBOARD", False
        flies = self.armed and self.mode in ("OFFBOARD", "GUIDED")
        if self.mode == "GUIDED" and now - self._latest > 3.0:
            flies = False
        dt, self._last = now - self._last, now
        self.move(self.wanted if flies else [0.0] * 3, dt)
        if not self.frozen:
            self.seconds = 1e-3 + now - self._begin
        self.tell([math.nan] * 3 if self.broken else self.place)

    def move(self, wanted, dt):
        """Fly towards a velocity for some time, north, east and down."""
        for axis in range(3):
            change = max(-ACCELERATION * dt, min(ACCELERATION * dt, wanted[axis] - self.velocity[axis]))
            self.velocity[axis] += change
            self.place[axis] += self.velocity[axis] * dt

    def note_stream(self):
        """Note what keeps it in Offboard or Guided."""
        now = self._clock()
        if now - self._latest > STREAM_GAP:
            self._gap_since = now
        self._latest, self.accepted = now, self.accepted + 1

    def read(self):
        """Read what has come."""
        raise NotImplementedError

    def tell(self, place):
        """Tell the place, and mode and arming."""
        raise NotImplementedError

    def close(self):
        """Close the connection."""
        raise NotImplementedError
