"""A vehicle's side of the link: observations out, set-points in. For the simulator and for bridges to real vehicles."""

import time
from collections.abc import Callable
from typing import Final

import numpy as np

from eia_sec.common.errors import ProtocolError, SchemaError
from eia_sec.common.incarnation import new_incarnation
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import Envelope, ObservationMessage, SetpointMessage
from eia_sec.common.team import Float32
from eia_sec.common.transport.bus import Bus

WAITING: Final = 4
"""Set-points that wait to be read; the oldest are dropped."""
RELEASE_SECONDS: Final = 2.0
"""After this silence of a flight node, a lower incarnation is obeyed, because the first clock was ahead."""


class VehicleLink:
    """One vehicle on the bus.

    Args:
        bus: the control lane.
        run: the run's name.
        vehicle: the vehicle's name; with TLS that of its certificate.
        agent: the agent that flies it.
        fastest: largest speed along x and y that it accepts, m/s.
        clock: seconds since 1970.

    Attributes:
        refused: set-points that were not obeyed: malformed, old, for another agent, or too fast.
    """

    def __init__(
        self,
        bus: Bus,
        run: str,
        vehicle: str,
        agent: str,
        fastest: tuple[float, float],
        clock: Callable[[], float] = time.time,
    ) -> None:
        self._publisher = bus.publish(keys.OBSERVATION.key(run, vehicle=vehicle))
        self._setpoints = bus.subscribe(keys.SETPOINT.key(run, vehicle=vehicle), WAITING)
        self._vehicle, self._agent, self._fastest, self._clock = vehicle, agent, fastest, clock
        self._start, self._sequence = new_incarnation(), 0
        self._mark, self._obeyed = (0, 0), float("-inf")
        self._values: Float32 = np.zeros(0, np.float32)
        self.refused = 0

    def observe(self, values: Float32) -> int:
        """Publish an observation; return its number.

        Args:
            values: [o] float32, scaled as in training.
        """
        self._sequence += 1
        self._values = np.ascontiguousarray(values, np.float32).copy()
        self.repeat()
        return self._sequence

    def repeat(self) -> None:
        """Publish the last observation again under its number, because it or its set-point may have been lost.

        Actors with memory count it once.
        """
        message = ObservationMessage(self._agent, int(self._clock() * 1e6), self._values)
        self._publisher.put(message.encode(), Envelope("vehicle", self._vehicle, self._start, self._sequence).encode())

    def setpoints(self) -> list[SetpointMessage]:
        """Return the set-points since the last call, oldest first; the vehicle obeys the last one."""
        found = []
        for sample in self._setpoints.drain():
            try:
                sender, message = Envelope.decode(sample.attachment), SetpointMessage.decode(sample.payload)
                self._check(sender, message)
            except ProtocolError:
                self.refused += 1
                continue
            self._mark, self._obeyed = (sender.incarnation, sender.sequence), time.monotonic()
            found.append(message)
        return found

    def _check(self, sender: Envelope, message: SetpointMessage) -> None:
        older = (sender.incarnation, sender.sequence) <= self._mark
        if sender.role != "flight" or (older and time.monotonic() - self._obeyed < RELEASE_SECONDS):
            raise ProtocolError("the set-point is old, or not from a flight node.")
        if message.agent != self._agent or len(message.velocity) != 2:
            raise SchemaError("the set-point is for another agent.")
        if any(abs(part) > most for part, most in zip(message.velocity, self._fastest, strict=True)):
            raise SchemaError("the set-point is faster than this vehicle may fly.")
        if message.hover and any(message.velocity):
            raise SchemaError("a hover set-point must have velocity 0.")
