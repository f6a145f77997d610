"""Vehicles' poses: which are used, where the vehicle is, what it has served, and why it has to hover."""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from eia_sec.common.config import FarmConfig
from eia_sec.common.errors import ProtocolError, SchemaError
from eia_sec.common.protocol.messages import Envelope, PoseMessage
from eia_sec.rollout.farm_files.projection import TangentPlane

OUTSIDE: Final = 50.0
"""Distance from the field from which on a pose belongs to another one, m."""
SETTLING: Final = 1.0
"""Seconds without a jump after which poses are trusted again."""
MARGIN: Final = 1.2
"""How many times its top speed a vehicle may fly: wind, overshoot and its estimator's noise."""
LARGEST: Final = 1e3
"""Largest speed, acceleration and wind in a pose, m/s and m/s^2; more is another unit."""
MOST_SERVED: Final = 4096
"""Most plots or sensors in one pose."""
HEIGHT: Final = 2.0
"""How far a vehicle's height may be from its type's, m; farther, it hovers, because take-off belongs to the pilot."""
DOUBLED: Final = 2.0
"""Seconds for which two vehicles of one name hover after both have been heard."""
LOST_SECONDS: Final = 10.0
"""Silence after which a vehicle is lost for good, where the farm loses UAVs, s."""


@dataclass(frozen=True)
class Field:
    """What poses are compared with.

    Attributes:
        config: the farm.
        origin: the corner where x and y are 0, whence x leads east and y north; None where vehicles send x and y.
        age: oldest pose that is used, and largest difference between the clocks, s.
    """

    config: FarmConfig
    origin: TangentPlane | None = None
    age: float = 1.0

    @property
    def fastest(self) -> float:
        """Speed of which a pose is not a jump, m/s."""
        world = self.config.world
        return MARGIN * math.hypot(world.speed_x_max, world.speed_y_max)

    def place(self, message: PoseMessage) -> tuple[float, float]:
        """Return a pose's x and y, m; raise SchemaError where nobody knows the origin of its degrees."""
        first, second = message.place
        if not message.geodetic:
            return first, second
        if self.origin is None:
            raise SchemaError("it has latitude and longitude; tell the flight node --origin.")
        if not (abs(first) <= 90.0 and abs(second) <= 180.0):
            raise SchemaError(f"({first:g}, {second:g}) is no latitude and longitude.")
        east, north, _ = self.origin.to_metres(np.array([[second, first]]))[0].tolist()
        return east, north

    def outside(self, place: tuple[float, float]) -> float:
        """Return the distance of a place from the field, m."""
        world = self.config.world
        over = (max(0.0, -at, at - side) for at, side in zip(place, (world.field_x, world.field_y), strict=True))
        return math.hypot(*over)


@dataclass
class Vehicle:
    """One vehicle of the team, by its poses.

    Attributes:
        name: its name on the bus.
        agent: the agent that it flies as.
        row: the agent's number in the team.
        items: plots or sensors that it may serve; 0 for a relay.
        height: at which the agent flies, m.
        flown: whether this node flies it.
        newest: its newest pose that is used.
        place: the last place that is trusted, m.
        raw: the newest place, trusted or not, m.
        began: when the newest pose came, by the pilot's monotonic clock, s.
        answered: whether a set-point has followed it.
        reason: why it hovers in this period, or empty.
        cause: the reason's sort.
        causes: hover set-points by cause.
        refused: poses that were not used.
        misreported: reports of plots or sensors that do not exist, or from the future.
        missed: poses that never arrived.
        jumps: poses that are too far from the one before.
        lost: whether it is lost for good.
    """

    name: str
    agent: str
    row: int
    items: int
    height: float
    flown: bool = True
    newest: PoseMessage | None = None
    place: tuple[float, float] | None = None
    raw: tuple[float, float] = (0.0, 0.0)
    began: float = 0.0
    answered: bool = True
    reason: str = ""
    cause: str = ""
    causes: Counter[str] = field(default_factory=Counter)
    refused: int = 0
    misreported: int = 0
    missed: int = 0
    jumps: int = 0
    lost: bool = False
    acceleration: tuple[float, float] = (0.0, 0.0)
    _mark: tuple[int, int] = (0, 0)
    _settled: int = 0
    _jump: float = 0.0
    _doubled: float = -math.inf
    _complaint: str = ""
    _pending: dict[int, int] = field(default_factory=dict)
    _told: dict[int, int] = field(default_factory=dict)

    def take(self, payload: bytes, attachment: bytes, now: float, began: float, field_: Field) -> bool:
        """Take a pose; return whether it is used.

        Args:
            payload: its frame.
            attachment: the envelope's frame.
            now: seconds since 1970.
            began: the pilot's clock.
            field_: what it is compared with.
        """
        try:
            sender, message = self._checked(payload, attachment, now, began, field_)
            raw = field_.place(message)
        except ProtocolError as error:
            self.refused += 1
            self._complaint = str(error)
            return False
        start, before = self._mark
        self.missed += max(0, sender.sequence - before - 1) if sender.incarnation == start else 0
        self._mark, self._complaint = (sender.incarnation, sender.sequence), ""
        self._compare(message, raw, field_)
        self.newest, self.raw, self.began, self.answered = message, raw, began, False
        if message.stamp >= self._settled and field_.outside(raw) <= OUTSIDE:
            self.place = raw
        for item, stamp in zip(message.served.tolist(), message.served_stamp.tolist(), strict=True):
            if not (0 <= item < self.items and 0 <= stamp <= message.stamp):
                self.misreported += 1
            elif stamp > self._told.get(item, -1):
                self._told[item] = self._pending[item] = stamp
        return True

    @property
    def start(self) -> int:
        """The incarnation of the vehicle that told the newest pose; 0 before the first."""
        return self._mark[0]

    def place_at(self, now: float | None) -> tuple[float, float] | None:
        """Return where the vehicle is by now, m: it has flown on since its pose was measured.

        Args:
            now: seconds since 1970; None for where it was then.
        """
        if now is None or self.place is None or self.newest is None or self.reason or self.place != self.raw:
            return self.place
        age = max(0.0, now - self.newest.stamp / 1e6)
        x, y = (at + age * speed for at, speed in zip(self.place, self.newest.velocity, strict=True))
        return x, y

    def judge(self, now: float, clock: float, field_: Field) -> None:
        """Decide whether the vehicle has to hover in this period, and why.

        Args:
            now: seconds since 1970.
            clock: the pilot's monotonic clock, s.
            field_: what poses are compared with.
        """
        self.cause, self.reason = self._objection(now, clock, field_)

    def visits(self) -> Iterator[tuple[int, int]]:
        """Yield what was served since the last call, with its time stamp."""
        pending, self._pending = self._pending, {}
        yield from pending.items()

    def _checked(
        self, payload: bytes, attachment: bytes, now: float, clock: float, field_: Field
    ) -> tuple[Envelope, PoseMessage]:
        sender, message = Envelope.decode(attachment), PoseMessage.decode(payload)
        if (sender.role, sender.name) != ("vehicle", self.name):
            raise ProtocolError(f"the envelope names {sender.role[:16]} {sender.name[:64]!r}.")
        if sender.incarnation < self._mark[0] and clock - self.began <= field_.age:
            self._doubled = clock
        # An incarnation that is invented or from a fast clock locks nobody out for longer than the age.
        before = self.newest.stamp if self.newest is not None else 0
        waited = message.stamp > before + field_.age * 1e6
        if (sender.incarnation, sender.sequence) <= self._mark and not waited:
            raise ProtocolError(f"pose {sender.sequence} is not newer than {self._mark[1]}.")
        if message.agent != self.agent:
            raise SchemaError(f"it is of agent {message.agent[:64]!r}, not {self.agent}.")
        self._require_numbers(message)
        age = now - message.stamp / 1e6
        if abs(age) > field_.age:
            raise ProtocolError(_old(age))
        return sender, message

    def _require_numbers(self, message: PoseMessage) -> None:
        """Raise SchemaError for numbers that no vehicle of this agent sends."""
        pairs = message.place, message.velocity, message.acceleration, message.commanded, message.wind
        if any(len(pair) not in sizes for pair, sizes in zip(pairs, ((2,), (2,), (0, 2), (0, 2), (0, 2)), strict=True)):
            raise SchemaError("a pose's vectors have two numbers each.")
        if any(abs(part) > LARGEST for pair in pairs[1:] for part in pair):
            raise SchemaError(f"a speed, an acceleration or a wind exceeds {LARGEST:g}; is it in metres and seconds?")
        served, stamps = message.served, message.served_stamp
        if served.ndim != 1 or served.shape != stamps.shape or len(served) > MOST_SERVED:
            raise SchemaError(f"what was served is not one list of at most {MOST_SERVED} with their time stamps.")

    def _compare(self, message: PoseMessage, raw: tuple[float, float], field_: Field) -> None:
        """Notice jumps, and estimate the acceleration where the vehicle does not tell."""
        if self.newest is None:
            self.acceleration = _pair(message.acceleration)
            return
        seconds = max(0.0, (message.stamp - self.newest.stamp) / 1e6)
        way = math.dist(raw, self.raw)
        # A simulator moves by a whole step at once, and a receiver corrects itself by as much.
        if way > field_.fastest * (seconds + field_.config.world.step_seconds):
            self.jumps += 1
            self._jump, self._settled = way, message.stamp + int(SETTLING * 1e6)
        if message.acceleration:
            self.acceleration = _pair(message.acceleration)
        elif seconds > 0.0:
            gained = [after - before for after, before in zip(message.velocity, self.newest.velocity, strict=True)]
            self.acceleration = gained[0] / seconds, gained[1] / seconds

    def _objection(self, now: float, clock: float, field_: Field) -> tuple[str, str]:
        pose = self.newest
        silent = clock - self.began
        late = pose is None or max(abs(now - pose.stamp / 1e6), silent) > field_.age
        found = "", ""
        if self.lost or (pose is not None and pose.lost):
            found = "lost", "it is out of service"
        elif late and self._complaint:
            found = "late", f"its pose cannot be used: {self._complaint}"
        elif pose is None:
            found = "missing", "no pose has come yet"
        elif late:
            found = "late", f"no pose for {max(silent, now - pose.stamp / 1e6):.1f} s"
        elif clock - self._doubled < DOUBLED:
            found = "doubled", "two vehicles have this name; stop one of them"
        elif (over := field_.outside(self.raw)) > OUTSIDE:
            found = "field", f"it is {over:.0f} m outside the field; is it another one's?"
        elif pose.stamp < self._settled:
            found = "jump", f"its pose jumped by {self._jump:.0f} m"
        elif abs(pose.height - self.height) > HEIGHT:
            found = "height", f"it is {pose.height:.1f} m high, and its type flies at {self.height:g} m"
        elif field_.config.battery.some and pose.charge is None:
            found = "sensors", "it does not tell its battery's charge"
        elif field_.config.wind.some and not pose.wind:
            found = "sensors", "it does not tell the wind"
        return found


def _old(age: float) -> str:
    return f"it is {age:.1f} s old" if age > 0 else f"it is {-age:.1f} s ahead of this machine's clock"


def _pair(numbers: tuple[float, ...]) -> tuple[float, float]:
    return (numbers[0], numbers[1]) if numbers else (0.0, 0.0)
