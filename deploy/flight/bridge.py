"""A bridge between a vehicle's link and its autopilot: which set-points go there, when they begin and when they end.

Arming, modes and every kind of recovery stay the pilot's and the autopilot's: the bridge sends velocity set-points
alone. Their stream ends with the flight node's and with the autopilot's positions, so the autopilot's own time-out
acts. Each new stream commands velocity 0 until the pilot gives it the go: a change of mode, or of arming, while it
streams. What a failsafe changes is no go: PX4 goes back to Offboard by itself when the stream is there again.

In doubt the vehicle keeps its height and does not move: a set-point counts only near its height, by a fresh position.
"""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, Protocol

from eia_sec.common.log import log
from eia_sec.common.protocol.messages import SetpointMessage
from eia_sec.deploy.flight.poses import HEIGHT
from eia_sec.deploy.flight.vehicle import Pose, VehicleLink

STOP_SECONDS: Final = 2.0
"""Silence of the flight node after which the stream of set-points ends; until then the vehicle is told to hover."""
COUNT_SECONDS: Final = 1.0
"""Time between two looks at what was refused."""
POSITION_SECONDS: Final = 1.0
"""Age of the newest position after which the stream of set-points ends."""
FRESH_SECONDS: Final = 0.5
"""Age of the newest position up to which the vehicle moves."""
HELD_SECONDS: Final = 10.0
"""Longest time for which a link holds a message back; one that seems older comes from an autopilot that began anew."""
DRIFT: Final = 2e-4
"""How much faster or slower the autopilot's clock may run."""
CLIMB_GAIN: Final = 1.0
"""Climb per metre that the height is off, 1/s."""
CLIMB: Final = 1.0
"""Fastest climb or descent, m/s."""

Ned = tuple[float, float, float]
"""North, east and down."""


@dataclass(frozen=True)
class Position:
    """Where an autopilot says that it is.

    Attributes:
        pose: without its age.
        measured: when, on the autopilot's clock, s.
    """

    pose: Pose
    measured: float


@dataclass(frozen=True)
class Mode:
    """The state of an autopilot that its pilot sets, but for failsafes.

    Attributes:
        name: what it calls its mode.
        armed: whether it is armed.
        failsafe: whether a failsafe acts, so that the mode may be the autopilot's own choice.
    """

    name: str
    armed: bool
    failsafe: bool = False


class Autopilot(Protocol):
    """The way to an autopilot, in its own protocol."""

    def read(self) -> Sequence[Position | Mode]:
        """Return what has come since the last call, of each kind the oldest first; send what is due in each period."""

    def send(self, velocity: Ned, heading: float) -> None:
        """Send a set-point: a velocity in m/s, and a heading from north, clockwise, in radians."""

    def close(self) -> None:
        """Close the way."""


class Bridge:
    """One vehicle's bridge.

    Args:
        link: the vehicle's link to the flight node.
        autopilot: the way to its autopilot.
        monotonic: seconds that never go back.

    Attributes:
        sent: set-points sent to the autopilot.
        frozen: positions whose time did not go on, or with numbers that are not finite, which are not told.
        mode: what the autopilot last said of itself, or None before.
    """

    def __init__(
        self, link: VehicleLink, autopilot: Autopilot, monotonic: Callable[[], float] = time.monotonic
    ) -> None:
        self._link, self._autopilot, self._monotonic = link, autopilot, monotonic
        self._clock = AutopilotClock()
        self._height, self._measured = 0.0, -math.inf
        self._streams = self._go = False
        self._chosen: Mode | None = None  # by the pilot, as this stream has seen it
        self._counts, self._counted = (0, 0, 0, 0), monotonic()
        self.sent = self.frozen = 0
        self.mode: Mode | None = None

    def turn(self) -> None:
        """Process one period: tell where the vehicle is, and pass on what it has to fly."""
        now = self._monotonic()
        pose = self._read(now)
        if pose is not None:
            self._link.publish(pose)
        self._stream(now)  # before set-points are read, so that no silence goes unseen
        setpoint = self._link.setpoint()
        self._stream(now)
        if self._streams:
            self._send(setpoint, now)
        if now - self._counted >= COUNT_SECONDS:
            self._counted = now
            self._count()

    def close(self) -> None:
        """Close the way to the autopilot."""
        self._autopilot.close()

    def _count(self) -> None:
        """Log what has been refused since the last time."""
        counts = self._link.refused, self._link.lapses, self._link.untold, self.frozen
        refused, lapses, untold, frozen = (new - old for new, old in zip(counts, self._counts, strict=True))
        self._counts = counts
        if refused:
            log(f"{refused} set-points refused; the last: {self._link.complaint}")
        if lapses:
            log(f"{lapses} set-points ran out of validity; the vehicle hovered.")
        if untold:
            log(f"{untold} reports were replaced by newer ones, because there were too many.")
        if frozen:
            log(f"{frozen} positions of the autopilot are not new, or not finite.")

    def _stream(self, now: float) -> None:
        """Begin or end the stream of set-points."""
        reason = ""
        if self._link.silent >= STOP_SECONDS:
            reason = "the flight node is silent"
        elif now - self._measured >= POSITION_SECONDS:
            reason = "the autopilot's position is old"
        if self._streams == (not reason):
            return
        self._streams, self._go, self._chosen = not reason, False, None
        begun = "set-points stream; the vehicle hovers until the pilot changes its mode or arming."
        log(f"{reason}; the stream ends." if reason else begun)

    def _read(self, now: float) -> Pose | None:
        """Read what has come; return the newest pose, or None if none is new."""
        found: Pose | None = None
        for told in self._autopilot.read():
            if isinstance(told, Mode):
                self._note(told)
            elif _finite(told.pose) and self._clock.goes_on(told.measured, now):
                found = told.pose
            else:
                self.frozen += 1
        if found is None:
            return None
        self._height, self._measured = found.height, now - self._clock.age
        return replace(found, age=self._clock.age)

    def _note(self, mode: Mode) -> None:
        """Log a change of mode or arming; the pilot's lets a stream move the vehicle."""
        if mode != self.mode:
            why = ", by a failsafe" if mode.failsafe else ""
            log(f"the autopilot is {'armed' if mode.armed else 'disarmed'}, in mode {mode.name}{why}.")
        self.mode = mode
        if not mode.failsafe:
            self._go = self._go or self._chosen not in (None, mode)
            self._chosen = mode

    def _send(self, setpoint: SetpointMessage, now: float) -> None:
        """Send a set-point: north is y and east is x; down follows from the height. In doubt all are 0."""
        east, north, down = 0.0, 0.0, 0.0
        off = setpoint.height - self._height
        if self._go and not setpoint.hover and now - self._measured <= FRESH_SECONDS and abs(off) <= HEIGHT:
            east, north = setpoint.velocity
            down = -max(-CLIMB, min(CLIMB, CLIMB_GAIN * off))
        self._autopilot.send((north, east, down), _heading(setpoint.yaw))
        self.sent += 1


class AutopilotClock:
    """When positions were measured, by an autopilot's seconds since its start.

    The quickest message on the way tells the difference of the clocks; one that is later was measured earlier.

    Attributes:
        age: of the newest position when it was read, s.
    """

    def __init__(self) -> None:
        self._newest, self._read, self._difference = 0.0, -math.inf, math.inf
        self.age = 0.0

    def goes_on(self, measured: float, now: float) -> bool:
        """Note a position's time; return whether it is newer than all before, or the autopilot has begun anew.

        Args:
            measured: seconds since the autopilot's start.
            now: seconds that never go back.
        """
        difference, known = now - measured, self._difference + DRIFT * (now - self._read)
        earlier, older = measured < self._newest, difference - known > HELD_SECONDS
        restarted = (earlier or older) and now - self._read > POSITION_SECONDS
        if measured == self._newest or (earlier and not restarted):
            return False
        if restarted:
            known = math.inf
        self._difference = min(difference, known)
        self._newest, self._read, self.age = measured, now, difference - self._difference
        return True


def pose_of(place: Ned, velocity: Ned, corner: tuple[float, float], wind: tuple[float, ...] = ()) -> Pose:
    """Return the pose of what an autopilot tells in its own frame.

    Args:
        place: from the autopilot's origin, m.
        velocity: m/s.
        corner: east and north of that origin in the field, m.
        wind: along x and y, m/s; empty if it does not know it.
    """
    north, east, down = place
    return Pose((corner[0] + east, corner[1] + north), -down, (velocity[1], velocity[0]), wind=wind)


def _finite(pose: Pose) -> bool:
    """Return whether place, height and velocity are finite numbers."""
    return all(map(math.isfinite, (*pose.place, pose.height, *pose.velocity)))


def _heading(yaw: float) -> float:
    """Return a yaw from the field's x axis, which points east, as one from north, clockwise, in [-pi, pi)."""
    return (math.pi / 2.0 - yaw + math.pi) % (2.0 * math.pi) - math.pi
