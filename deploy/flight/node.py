"""The flight node: a pilot on the bus, at a fixed rate."""

import re
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from eia_sec.common.config import RunConfig
from eia_sec.common.config.files import to_toml
from eia_sec.common.errors import UsageError
from eia_sec.common.log import log
from eia_sec.common.process import Presence, StopSignal
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.messages import Envelope, SetpointMessage
from eia_sec.common.transport.admission import admission
from eia_sec.common.transport.bus import Bus
from eia_sec.common.transport.endpoint import Endpoint
from eia_sec.deploy.flight.farm_map import FarmMap
from eia_sec.deploy.flight.pilot import Pilot
from eia_sec.deploy.flight.record import FlightRecord
from eia_sec.rollout.followed_farm import FollowedFarm
from eia_sec.rollout.worker.collector import StepObserver
from eia_sec.rollout.worker.view_service import ViewService

WAITING: Final = 16
"""Poses of one vehicle that wait for the next period; the oldest are dropped."""
REPORT_SECONDS: Final = 1.0
LAST_HOVERS: Final = 3
"""Hover set-points at the end; several, because set-points may be lost."""
LAST_PAUSE: Final = 0.1
"""Longest pause after each of them, s; a period if that is shorter."""


@dataclass(frozen=True)
class NodeOptions:
    """Options of a flight node.

    Attributes:
        run: the run's name.
        name: the node's name.
        start: its incarnation.
        rate: periods per second.
        seconds: time until it stops, or None.
        listens: where vehicles connect to it, or None when it is connected to a router or a learner itself.
    """

    run: str
    name: str
    start: int
    rate: float = 10.0
    seconds: float | None = None
    listens: Endpoint | None = None


def require_absent(bus: Bus, run: str, name: str) -> None:
    """Refuse to fly beside a living node of the same name, which would begin its farm anew.

    Raises:
        UsageError: there is one.
    """
    if bus.living(keys.LIVE.key(run, role="flight", name=name)):
        raise UsageError(f"a flight node {name} of run {run} is flying; stop it, or stand by with --name spare.")


class _Shown:
    """The map of a flight, as watchers see it; a step that was slept through is not shown.

    Attributes:
        environments: the map.
        simulated: steps that were noted.
        probe: see `eia_sec.rollout.worker.view_service.Watched`.
    """

    def __init__(self, farm: FollowedFarm) -> None:
        self.environments, self.simulated = farm, 0
        self.probe: StepObserver | None = None

    def note(self) -> None:
        """Note a step of the map, or its beginning."""
        self.simulated += self.environments.time[0] > 0
        if self.probe is not None:
            self.probe.record()


class FlightView:
    """A flight for watchers: its map, step by step.

    Args:
        bus: the control lane.
        run: the run's name.
        name: that of the flight node.
        start: its incarnation.
        farm_map: what is shown.
    """

    def __init__(self, bus: Bus, run: str, name: str, start: int, farm_map: FarmMap) -> None:
        self._map, self._noted = farm_map, (farm_map.begun, farm_map.steps)
        self._shown = _Shown(farm_map.farm)
        toml = to_toml(RunConfig(farm=farm_map.farm.config))
        self._views = ViewService(bus, run, name, start, self._shown, toml, role="flight")

    def poll(self) -> bool:
        """Show what is new; return whether the map has begun or moved since the last call."""
        before, self._noted = self._noted, (self._map.begun, self._map.steps)
        if before != self._noted:
            self._shown.note()
        self._views.poll(0, 0.0, uniform=False)
        return before != self._noted


class FlightNode:
    """Reads poses, decides and sends set-points, once per period.

    Args:
        options: run, name and rate.
        pilot: decides.
        bus: the control lane.
        record: where the flight is noted, if anywhere.

    Attributes:
        overruns: periods that were skipped because the previous one took too long.
    """

    def __init__(self, options: NodeOptions, pilot: Pilot, bus: Bus, record: FlightRecord | None = None) -> None:
        self._options, self._pilot, self._record = options, pilot, record
        run, vehicles = options.run, pilot.vehicles
        self._incoming = {name: bus.subscribe(keys.POSE.key(run, vehicle=name), WAITING) for name in vehicles}
        flown = [name for name, vehicle in vehicles.items() if vehicle.flown]
        encoding = keys.SETPOINT.encoding
        self._outgoing = {name: bus.publish(keys.SETPOINT.key(run, vehicle=name), encoding) for name in flown}
        self._presence = Presence(bus, run, "flight", options.name, options.start)
        self._view = FlightView(bus, run, options.name, options.start, pilot.map)
        self._reported = 0.0
        self._said: list[str] = []
        self.overruns = 0

    def run(self, stop: StopSignal) -> None:
        """Work until stopped or the farm's episode is over; at the end every vehicle gets hover set-points."""
        period = 1.0 / self._options.rate
        begun = due = time.monotonic()
        seconds = self._options.seconds if self._options.seconds is not None else float("inf")
        try:
            while not stop and not self._pilot.over and time.monotonic() - begun < seconds:
                self.turn()
                due += period
                behind = time.monotonic() - due
                if behind > 0:
                    skipped = int(behind / period) + 1
                    self.overruns += skipped
                    due += skipped * period
                stop.event.wait(max(0.0, due - time.monotonic()))
        finally:
            steps = self._pilot.map.steps
            why = f"the flight's {steps} steps are over" if self._pilot.over else "the flight node is stopping"
            for _ in range(LAST_HOVERS):
                self._send(self._pilot.hover(why))
                time.sleep(min(period, LAST_PAUSE))  # a message right before the session closes may be lost
            self._report()

    def turn(self) -> None:
        """Process one period."""
        for vehicle, incoming in self._incoming.items():
            for sample in incoming.drain():
                if self._pilot.offer(vehicle, sample.payload, sample.attachment, time.time()):
                    self._note_pose(vehicle)
        setpoints = self._pilot.decide(time.time())
        self._send(setpoints)
        if self._view.poll() and self._record is not None:
            self._record.farm(self._pilot.map.farm, time.time())
        if time.monotonic() - self._reported >= REPORT_SECONDS:
            self._report()

    def _send(self, setpoints: Mapping[str, SetpointMessage]) -> None:
        for vehicle, message in setpoints.items():
            envelope = Envelope("flight", self._options.name, self._options.start, message.period)
            self._outgoing[vehicle].put(message.encode(), envelope.encode())
            if self._record is not None:
                self._record.setpoint(vehicle, message, time.time())

    def _note_pose(self, vehicle: str) -> None:
        own = self._pilot.vehicles[vehicle]
        if self._record is not None and own.newest is not None:
            self._record.pose(vehicle, own.newest, own.raw, time.time())

    def _report(self) -> None:
        self._reported = time.monotonic()
        values = {"period_seconds": 1.0 / self._options.rate, "overruns": self.overruns, **self._pilot.report()}
        if self._options.listens is not None:
            crowd = admission(self._options.listens)
            values |= {**crowd.metrics(), "alarms": [*values["alarms"], *crowd.alarms()]}
        if self._record is not None:
            values |= {
                "recorded": self._record.written,
                "unrecorded": self._record.lost,
                "alarms": [*values["alarms"], *self._record.alarms()],
            }
        self._presence.report(values)
        self._say(values["alarms"])

    def _say(self, alarms: list[str]) -> None:
        """Log alarms that are new but for their numbers, because a flight may have no monitor."""
        plain = [re.sub(r"\d[\d.,]*", "#", alarm) for alarm in alarms]
        for text, alarm in zip(plain, alarms, strict=True):
            if text not in self._said:
                log(alarm)
        self._said = plain
