"""A vehicle's side of the link: poses out, set-points in. For the simulator and for bridges to real vehicles.

A vehicle obeys one flight node at a time, the first that commands it. Another one's set-points, and those of another
start of the same, are refused until the first has been silent for RELEASE_SECONDS. Poses tell whom the vehicle obeys,
and who else wants it, so both nodes know.

A set-point that moves the vehicle answers a pose that this very link has published of late, by its own monotonic clock.
So neither old messages nor those for another vehicle of the same name are flown, whatever any clock shows.
"""

import math
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from eia_sec.common.errors import ProtocolError, SchemaError
from eia_sec.common.incarnation import new_incarnation
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import Envelope, PoseMessage, SetpointMessage
from eia_sec.common.transport.bus import Bus

WAITING: Final = 16
"""Set-points that wait to be read; the oldest are dropped."""
RELEASE_SECONDS: Final = 2.0
"""After this silence of a flight node the vehicle obeys another one, or another start of the same."""
NODES: Final = 64
"""Most starts of flight nodes whose last message is remembered, so that none is obeyed twice."""
RECENT_SECONDS: Final = 5.0
"""Time for which poses repeat what was served, because messages may be lost."""
MOST_RECENT: Final = 1024
"""Most plots or sensors that a pose repeats, the newest."""
LONGEST_VALIDITY: Final = 1.0
"""Longest validity of a set-point that is obeyed, s; shorter than RELEASE_SECONDS, so no claim ends before it."""
OLDEST_POSE: Final = 1.0
"""Oldest pose on which a decision is obeyed, s: it is flown until OLDEST_POSE and its validity have passed since the
pose, and no longer, however long it was on the way."""
HEIGHTS: Final = (2.0, 120.0)
"""Lowest and highest height at which a vehicle follows set-points unless told otherwise, m."""
HOVER: Final = (0.0, 0.0)


@dataclass(frozen=True)
class Pose:
    """What a vehicle knows of itself, in metres and seconds.

    Attributes:
        place: x and y in the field; or latitude and longitude, degrees.
        height: above the field.
        velocity: over ground along x and y.
        acceleration: likewise; empty if it does not know it.
        commanded: velocity that it is flown to now; empty if it does not know it.
        charge: of its battery, J; None if it does not know it.
        wind: along x and y; empty if it does not know it.
        geodetic: whether `place` is in degrees.
        lost: whether it is out of service for good.
        age: time since it was measured.
    """

    place: tuple[float, float]
    height: float
    velocity: tuple[float, float]
    acceleration: tuple[float, ...] = ()
    commanded: tuple[float, ...] = ()
    charge: float | None = None
    wind: tuple[float, ...] = ()
    geodetic: bool = False
    lost: bool = False
    age: float = 0.0


class VehicleLink:
    """One vehicle on the bus.

    Args:
        bus: the control lane.
        run: the run's name.
        vehicle: the vehicle's name; with TLS that of its certificate.
        agent: the agent that it flies as.
        fastest: largest speed along x and y that it accepts, m/s.
        heights: lowest and highest height to fly at that it accepts, m.
        clock: seconds since 1970.
        monotonic: seconds that never go back.

    Attributes:
        refused: set-points that were not obeyed: malformed, old, not on a pose of this link, for another agent, too
            fast, too low, too high, or of another node.
        complaint: why the last of them was not, or empty.
        lapses: times that a set-point's validity ended before the next one came.
        untold: reports that more than MOST_RECENT newer ones replaced within RECENT_SECONDS.
        node: the flight node that the vehicle obeys, or empty.
    """

    def __init__(
        self,
        bus: Bus,
        run: str,
        vehicle: str,
        agent: str,
        fastest: tuple[float, float],
        clock: Callable[[], float] = time.time,
        monotonic: Callable[[], float] = time.monotonic,
        heights: tuple[float, float] = HEIGHTS,
    ) -> None:
        self._publisher = bus.publish(keys.POSE.key(run, vehicle=vehicle), keys.POSE.encoding)
        self._setpoints = bus.subscribe(keys.SETPOINT.key(run, vehicle=vehicle), WAITING)
        self._vehicle, self._agent, self._fastest, self._heights = vehicle, agent, fastest, heights
        self._clock, self._monotonic = clock, monotonic
        self._start, self._sequence, self._stamp = new_incarnation(), 0, 0
        self._served: deque[tuple[int, int]] = deque(maxlen=MOST_RECENT)
        self._told: OrderedDict[int, float] = OrderedDict()
        self._marks: OrderedDict[tuple[str, int], int] = OrderedDict()
        self._node_start, self._heard, self._until = 0, -math.inf, -math.inf
        self._obeyed: SetpointMessage | None = None
        self._decision = 0
        self._rival, self._rivalled = "", -math.inf
        self.node = self.complaint = ""
        self.refused = self.lapses = self.untold = 0

    def serve(self, items: Iterable[int]) -> None:
        """Note plots that were photographed, or sensors whose packets were acknowledged, just now.

        Args:
            items: numbers of plots, column by column from the field's corner, or of sensors.
        """
        stamp = int(self._clock() * 1e6)
        found = [(int(item), stamp) for item in items]
        self.untold += max(0, len(self._served) + len(found) - MOST_RECENT)
        self._served.extend(found)

    def publish(self, pose: Pose) -> None:
        """Publish where the vehicle is, and what it has served of late."""
        now = self._monotonic()
        stamp = self._stamp = max(self._stamp + 1, int((self._clock() - pose.age) * 1e6))
        self._told[stamp] = now - pose.age
        while self._told and now - next(iter(self._told.values())) > OLDEST_POSE + LONGEST_VALIDITY:
            self._told.popitem(last=False)
        while self._served and stamp - self._served[0][1] > RECENT_SECONDS * 1e6:
            self._served.popleft()
        served = [(item, when) for item, when in self._served if when <= stamp]
        self._sequence += 1
        leads = self._leads()
        wanted = now - self._rivalled < RELEASE_SECONDS
        message = PoseMessage(
            agent=self._agent,
            stamp=stamp,
            place=pose.place,
            geodetic=pose.geodetic,
            height=pose.height,
            velocity=pose.velocity,
            acceleration=pose.acceleration,
            commanded=pose.commanded,
            charge=pose.charge,
            wind=pose.wind,
            lost=pose.lost,
            decision=self._decision,
            node=self.node if leads else "",
            node_start=self._node_start if leads else 0,
            rival=self._rival if wanted else "",
            served=np.array([item for item, _ in served], np.int32),
            served_stamp=np.array([when for _, when in served], np.int64),
        )
        self._publisher.put(message.encode(), Envelope("vehicle", self._vehicle, self._start, self._sequence).encode())

    def setpoint(self) -> SetpointMessage:
        """Return what the vehicle has to fly now: the newest set-point, or hover when its validity is over."""
        for sample in self._setpoints.drain():
            try:
                sender, message = Envelope.decode(sample.attachment), SetpointMessage.decode(sample.payload)
                self._check(sender, message)
            except ProtocolError as error:
                self.refused, self.complaint = self.refused + 1, str(error)
                continue
            self._heard = self._monotonic()
            told = math.inf if message.hover else self._told[message.stamp]
            self._until = min(self._heard, told + OLDEST_POSE) + message.validity
            self._marks[sender.name, sender.incarnation] = sender.sequence
            self._marks.move_to_end((sender.name, sender.incarnation))
            if len(self._marks) > NODES:
                self._marks.popitem(last=False)
            self.node, self._node_start, self._obeyed = sender.name, sender.incarnation, message
            self._decision = message.decision or self._decision
        if self._obeyed is None:
            return self._hover("no set-point has come yet")
        if self._monotonic() > self._until:
            self.lapses += 1
            self._obeyed, self._until = self._hover("the last set-point's validity is over"), math.inf
        return self._obeyed

    @property
    def silent(self) -> float:
        """Seconds since the last set-point that was obeyed; infinite before the first."""
        return self._monotonic() - self._heard

    def _leads(self) -> bool:
        return bool(self.node) and self.silent < RELEASE_SECONDS

    def _hover(self, reason: str) -> SetpointMessage:
        """Return hover by the vehicle's own decision; no node's period has the number 0."""
        last = self._obeyed
        height, yaw = (last.height, last.yaw) if last is not None else (0.0, 0.0)
        return SetpointMessage(self._agent, HOVER, (), height, yaw, HOVER, True, reason, 0, 0, math.inf, 0, 0.0, 0)

    def _check(self, sender: Envelope, message: SetpointMessage) -> None:
        if sender.role != "flight":
            raise ProtocolError("the set-point is not from a flight node.")
        if self._leads() and (sender.name, sender.incarnation) != (self.node, self._node_start):
            self._rival, self._rivalled = sender.name, self._monotonic()
            raise ProtocolError(f"the vehicle obeys the flight node {self.node}.")
        if sender.sequence <= self._marks.get((sender.name, sender.incarnation), -1):
            raise ProtocolError("the set-point is not newer than the last one.")
        if message.agent != self._agent or len(message.velocity) != 2:
            raise SchemaError("the set-point is for another agent.")
        if any(abs(part) > most for part, most in zip(message.velocity, self._fastest, strict=True)):
            raise SchemaError("the set-point is faster than this vehicle may fly.")
        if message.hover and any(message.velocity):
            raise SchemaError("a hover set-point must have velocity 0.")
        if not 0.0 < message.validity <= LONGEST_VALIDITY:
            raise SchemaError("the set-point's validity is no time for which to obey it.")
        if message.hover:
            return
        if not self._heights[0] <= message.height <= self._heights[1]:
            raise SchemaError("the set-point is lower or higher than this vehicle may fly.")
        told = self._told.get(message.stamp) if message.vehicle_start == self._start else None
        if told is None or self._monotonic() >= told + OLDEST_POSE + message.validity:
            raise ProtocolError("the set-point does not answer a pose that this vehicle has told of late.")
