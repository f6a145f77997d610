"""A vehicle's side of the link: poses out, set-points in. For the simulator and for bridges to real vehicles.

A vehicle obeys one flight node at a time, the first that commands it. Another one's set-points are refused until the
first has been silent for RELEASE_SECONDS. Poses tell whom the vehicle obeys, and who else wants it, so both nodes know.
"""

import math
import time
from collections import deque
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
"""After this silence of a flight node the vehicle obeys another one, or an earlier start of the same."""
RECENT_SECONDS: Final = 5.0
"""Time for which poses repeat what was served, because messages may be lost."""
MOST_RECENT: Final = 1024
"""Most plots or sensors that a pose repeats, the newest."""
LONGEST_VALIDITY: Final = 10.0
"""Longest validity of a set-point that is obeyed, s."""
OLDEST_POSE: Final = 2.0
"""Oldest pose on which a decision is obeyed, besides the set-point's validity, s. A link that was held up brings old
set-points at once."""
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


class VehicleLink:
    """One vehicle on the bus.

    Args:
        bus: the control lane.
        run: the run's name.
        vehicle: the vehicle's name; with TLS that of its certificate.
        agent: the agent that it flies as.
        fastest: largest speed along x and y that it accepts, m/s.
        clock: seconds since 1970.
        monotonic: seconds that never go back.

    Attributes:
        refused: set-points that were not obeyed: malformed, old, for another agent, too fast, or of another node.
        lapses: times that a set-point's validity ended before the next one came.
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
    ) -> None:
        self._publisher = bus.publish(keys.POSE.key(run, vehicle=vehicle))
        self._setpoints = bus.subscribe(keys.SETPOINT.key(run, vehicle=vehicle), WAITING)
        self._vehicle, self._agent, self._fastest = vehicle, agent, fastest
        self._clock, self._monotonic = clock, monotonic
        self._start, self._sequence, self._stamp = new_incarnation(), 0, 0
        self._served: deque[tuple[int, int]] = deque(maxlen=MOST_RECENT)
        self._mark, self._heard = (0, 0), -math.inf
        self._obeyed: SetpointMessage | None = None
        self._decision = 0
        self._rival, self._rivalled = "", -math.inf
        self.node = ""
        self.refused = self.lapses = 0

    def serve(self, items: Iterable[int]) -> None:
        """Note plots that were photographed, or sensors whose packets were acknowledged, just now.

        Args:
            items: numbers of plots, column by column from the field's corner, or of sensors.
        """
        stamp = self._now()
        self._served.extend((int(item), stamp) for item in items)

    def publish(self, pose: Pose) -> None:
        """Publish where the vehicle is, and what it has served of late."""
        stamp = self._now()
        while self._served and stamp - self._served[0][1] > RECENT_SECONDS * 1e6:
            self._served.popleft()
        self._sequence += 1
        leads = self._leads()
        wanted = self._monotonic() - self._rivalled < RELEASE_SECONDS
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
            node_start=self._mark[0] if leads else 0,
            rival=self._rival if wanted else "",
            served=np.array([item for item, _ in self._served], np.int32),
            served_stamp=np.array([when for _, when in self._served], np.int64),
        )
        self._publisher.put(message.encode(), Envelope("vehicle", self._vehicle, self._start, self._sequence).encode())

    def setpoint(self) -> SetpointMessage:
        """Return what the vehicle has to fly now: the newest set-point, or hover when its validity is over."""
        for sample in self._setpoints.drain():
            try:
                sender, message = Envelope.decode(sample.attachment), SetpointMessage.decode(sample.payload)
                self._check(sender, message)
            except ProtocolError:
                self.refused += 1
                continue
            self._mark, self._heard = (sender.incarnation, sender.sequence), self._monotonic()
            self.node, self._obeyed = sender.name, message
            self._decision = message.decision or self._decision
        silent = self._monotonic() - self._heard
        if self._obeyed is None:
            return self._hover("no set-point has come yet")
        if silent > self._obeyed.validity:
            if not (self._obeyed.hover and self._obeyed.period == 0):
                self.lapses += 1
            self._obeyed = self._hover("the last set-point's validity is over")
        return self._obeyed

    @property
    def silent(self) -> float:
        """Seconds since the last set-point that was obeyed; infinite before the first."""
        return self._monotonic() - self._heard

    def _now(self) -> int:
        """Return the time stamp of what is told now, greater than all before it, microseconds since 1970."""
        self._stamp = max(self._stamp + 1, int(self._clock() * 1e6))
        return self._stamp

    def _leads(self) -> bool:
        return bool(self.node) and self.silent < RELEASE_SECONDS

    def _hover(self, reason: str) -> SetpointMessage:
        """Return hover by the vehicle's own decision; no node's period has the number 0."""
        last = self._obeyed
        height, yaw = (last.height, last.yaw) if last is not None else (0.0, 0.0)
        return SetpointMessage(self._agent, HOVER, (), height, yaw, HOVER, True, reason, 0, 0, math.inf, 0, 0.0)

    def _check(self, sender: Envelope, message: SetpointMessage) -> None:
        if sender.role != "flight":
            raise ProtocolError("the set-point is not from a flight node.")
        if self._leads():
            if sender.name != self.node:
                self._rival, self._rivalled = sender.name, self._monotonic()
                raise ProtocolError(f"the vehicle obeys the flight node {self.node}.")
            if (sender.incarnation, sender.sequence) <= self._mark:
                raise ProtocolError("the set-point is not newer than the last one.")
        if message.agent != self._agent or len(message.velocity) != 2:
            raise SchemaError("the set-point is for another agent.")
        if any(abs(part) > most for part, most in zip(message.velocity, self._fastest, strict=True)):
            raise SchemaError("the set-point is faster than this vehicle may fly.")
        if not message.hover and self._clock() - message.stamp / 1e6 > message.validity + OLDEST_POSE:
            raise ProtocolError("the set-point follows from a pose that is too old.")
        if message.hover and any(message.velocity):
            raise SchemaError("a hover set-point must have velocity 0.")
        if not 0.0 < message.validity <= LONGEST_VALIDITY:
            raise SchemaError("the set-point's validity is no time for which to obey it.")
