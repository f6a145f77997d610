"""From vehicles' poses to set-points, with a watchdog; independent of the network.

    pilot.offer(vehicle, payload, attachment, now)      # everything that has arrived since the last period
    for vehicle, message in pilot.decide(now).items():  # once per period
        ...                                             # send it

The policy decides once in each step of the farm, as in training. In the periods between, the decision is sent again,
and the watchdog looks at every vehicle's newest pose.
"""

import math
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.errors import ConfigError
from eia_sec.common.protocol.messages import SetpointMessage
from eia_sec.common.team import Float32
from eia_sec.deploy.flight.border import inside_border
from eia_sec.deploy.flight.deciders import Decider
from eia_sec.deploy.flight.farm_map import FarmMap
from eia_sec.deploy.flight.poses import Field, Vehicle
from eia_sec.deploy.flight.vehicle import OLDEST_POSE

KEPT: Final = 1000
"""Newest set-points after a new pose that the reported latency covers."""
ROWS: Final = 16
"""Most vehicles that a report lists one by one, hovering ones first."""
REASONS: Final = 4
"""Most reasons to hover that alarms list one by one."""
REASON: Final = 160
"""Most characters of a reason."""
YAW: Final = 0.0
"""A vehicle's nose points along the field's x axis, so that its images' sides are along the plots'."""
CAUSES: Final = ("missing", "late", "doubled", "field", "jump", "height", "sensors", "lost", "policy", "end")
"""Why vehicles hover."""
BLIND: Final = ("missing", "late", "doubled", "field", "jump")
"""Those for which nobody knows where a vehicle is."""


@dataclass(frozen=True)
class PilotOptions:
    """How a pilot flies.

    Attributes:
        name: the flight node's name, which vehicles that obey it repeat.
        start: its incarnation.
        validity: seconds for which a vehicle may follow a set-point.
        lockstep: begin a step when every vehicle has flown the one before instead of by the clock; for simulators.
    """

    name: str = "main"
    start: int = 0
    validity: float = 0.5
    lockstep: bool = False


class Pilot:
    """Flies the vehicles of one team.

    Args:
        decider: decides in each step.
        farm_map: the farm.
        vehicles: the team, in the order of its agents.
        field: what poses are compared with.
        options: see there.
        clock: a monotonic clock, s.

    Attributes:
        period: periods begun.
        decisions: set-points of the policy.
        limited: those of them that the field's border limits.
        hovers: set-points that command hover.
    """

    def __init__(
        self,
        decider: Decider,
        farm_map: FarmMap,
        vehicles: Sequence[Vehicle],
        field: Field,
        options: PilotOptions,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._decider, self.map, self._field, self._options, self._clock = decider, farm_map, field, options, clock
        self.vehicles = {vehicle.name: vehicle for vehicle in vehicles}
        self._team = list(vehicles)
        world, dynamics = field.config.world, field.config.dynamics
        self._speed = np.array([world.speed_x_max, world.speed_y_max])
        tops = np.repeat(dynamics.of_types("speed") if dynamics.inertial else 3 * (math.inf,), world.counts)
        self._tops: NDArray[np.float64] = tops[:, None]
        self._shares: Float32 = np.full((len(vehicles), 2), np.nan, np.float32)
        self._stale: set[str] = set()
        self._decision, self._begun, self._listening = 0, 0.0, -1.0
        self._latency: deque[float] = deque(maxlen=KEPT)
        self._age: deque[float] = deque(maxlen=KEPT)
        self.period = self.decisions = self.limited = self.hovers = 0

    @property
    def over(self) -> bool:
        """Whether the farm's episode is over."""
        return self.map.over

    def offer(self, vehicle: str, payload: bytes, attachment: bytes, now: float) -> bool:
        """Take a pose; return whether it is used.

        Args:
            vehicle: the vehicle's name, from the message's key.
            payload: the pose's frame.
            attachment: the envelope's frame.
            now: seconds since 1970.
        """
        return self.vehicles[vehicle].take(payload, attachment, now, self._clock(), self._field)

    def decide(self, now: float) -> dict[str, SetpointMessage]:
        """Begin a period and return the set-point of every vehicle that this node flies.

        Args:
            now: seconds since 1970.
        """
        self.period += 1
        clock = self._clock()
        self._listening = clock if self._listening < 0.0 else self._listening
        self.map.lose(self._team, clock, self._listening)
        for vehicle in self._team:
            vehicle.judge(now, clock, self._field)
        self._advance(now)
        return {vehicle.name: self._setpoint(vehicle, now) for vehicle in self._team if vehicle.flown}

    def hover(self, reason: str) -> dict[str, SetpointMessage]:
        """Begin a period in which every vehicle hovers, for example the last one."""
        self.period += 1
        for vehicle in self._team:
            vehicle.cause, vehicle.reason = "end", reason
        return {vehicle.name: self._hover(vehicle) for vehicle in self._team if vehicle.flown}

    def report(self) -> dict[str, Any]:
        """Return the pilot's metrics, as `eia_sec.common.protocol.metrics` declares them."""
        flown = [vehicle for vehicle in self._team if vehicle.flown]
        worst = sorted(flown, key=lambda v: (not v.reason, -v.causes.total(), v.name))
        return {
            "periods": self.period,
            "steps": self.map.steps,
            "served": self.map.served,
            "decisions": self.decisions,
            "limited": self.limited,
            "hovers": self.hovers,
            "causes": {cause: sum(vehicle.causes[cause] for vehicle in flown) for cause in CAUSES},
            "refused": sum(vehicle.refused for vehicle in self._team),
            "misreported": sum(vehicle.misreported for vehicle in self._team),
            "missed": sum(vehicle.missed for vehicle in self._team),
            "jumps": sum(vehicle.jumps for vehicle in self._team),
            "standing_by": sum(bool(self._leader(vehicle)) for vehicle in flown),
            "latency": _spread(self._latency),
            "age": _spread(self._age),
            "vehicles": {
                vehicle.name: {
                    "agent": vehicle.agent,
                    "hovers": vehicle.causes.total(),
                    "refused": vehicle.refused,
                    "reason": vehicle.reason,
                    "obeys": vehicle.newest.node if vehicle.newest is not None else "",
                }
                for vehicle in worst[:ROWS]
            },
            "alarms": self._alarms(flown),
        }

    def _advance(self, now: float) -> None:
        """Take the steps over that are due, and decide after the last."""
        if self.map.over:
            return
        if not self.map.begun:
            if self.map.begin(self._team):
                self._begun = self._clock()
                self._decider.begin(self.map.farm)
                self._decide()
            return
        if not self._options.lockstep:
            behind = int((self._clock() - self._begun) / self._field.config.world.step_seconds) - self.map.steps
            if behind > 0:
                self.map.follow(self._team, behind, now)
                self._decide()
        elif all(self._has_flown(vehicle) for vehicle in self._team if vehicle.flown):
            self.map.follow(self._team, 1, None)
            self._decide()

    def _has_flown(self, vehicle: Vehicle) -> bool:
        flown = vehicle.newest is not None and vehicle.newest.decision == self._decision and not vehicle.reason
        return flown or vehicle.lost

    def _decide(self) -> None:
        if not self.map.over:
            self._decision = self.map.steps + 1
            self._shares = self._decider.decide(self.map.farm)
            # In lockstep a decision waits for its vehicle, and nothing moves meanwhile.
            self._stale = set() if self._options.lockstep else {v.name for v in self._team if v.cause in BLIND}

    def _setpoint(self, vehicle: Vehicle, now: float) -> SetpointMessage:
        if not vehicle.reason:
            vehicle.cause, vehicle.reason = self._policy_objection(vehicle)
        pose, place = vehicle.newest, vehicle.place
        if vehicle.reason or pose is None or place is None:
            return self._hover(vehicle)
        share = self._shares[vehicle.row]
        top = self._tops[vehicle.row]
        wanted: NDArray[np.float64] = np.clip(share.astype(np.float64) * self._speed, -top, top)
        velocity = inside_border(self._field.config, vehicle.row, wanted, place, OLDEST_POSE + self._options.validity)
        self.map.commanded(vehicle.row, velocity)
        self.decisions += 1
        self.limited += velocity != tuple(wanted.tolist())
        latency = self._clock() - vehicle.began
        if not vehicle.answered:
            vehicle.answered = True
            self._latency.append(latency)
            self._age.append(now - pose.stamp / 1e6)
        return SetpointMessage(
            agent=vehicle.agent,
            velocity=velocity,
            target=_target(self._field.config, place, velocity),
            height=vehicle.height,
            yaw=YAW,
            action=tuple(share.astype(np.float64).tolist()),
            hover=False,
            reason="",
            decision=self._decision,
            period=self.period,
            validity=self._options.validity,
            stamp=pose.stamp,
            latency=latency,
            vehicle_start=vehicle.start,
        )

    def _policy_objection(self, vehicle: Vehicle) -> tuple[str, str]:
        if self.map.over:
            return "end", f"the flight's {self._field.config.world.steps} steps are over"
        if not self.map.begun:
            absent = [other.name for other in self._team if other.place is None and not other.lost]
            rest = f" and {len(absent) - 1} others" if len(absent) > 1 else ""
            return "missing", f"the flight begins with the first pose of {absent[0]}{rest}"
        if vehicle.name in self._stale:
            return "late", "its pose was not known when the policy decided; it flies the next decision"
        if not np.isfinite(self._shares[vehicle.row]).all():
            return "policy", "the policy's output is not finite"
        return "", ""

    def _hover(self, vehicle: Vehicle) -> SetpointMessage:
        self.hovers += 1
        vehicle.causes[vehicle.cause] += 1
        self.map.commanded(vehicle.row, (0.0, 0.0))
        pose = vehicle.newest
        return SetpointMessage(
            agent=vehicle.agent,
            velocity=(0.0, 0.0),
            target=vehicle.place or (),
            height=vehicle.height,
            yaw=YAW,
            action=(0.0, 0.0),
            hover=True,
            reason=vehicle.reason[:REASON],
            decision=0,
            period=self.period,
            validity=self._options.validity,
            stamp=pose.stamp if pose is not None else 0,
            latency=self._clock() - vehicle.began if pose is not None else 0.0,
            vehicle_start=vehicle.start,
        )

    def _leader(self, vehicle: Vehicle) -> str:
        """Return the other flight node that a vehicle obeys, or an empty text."""
        pose, own = vehicle.newest, (self._options.name, self._options.start)
        if pose is None or not pose.node or (pose.node, pose.node_start) == own:
            return ""
        return pose.node if pose.node != own[0] else f"{pose.node} of another start"

    def _alarms(self, flown: Sequence[Vehicle]) -> list[str]:
        """Return one sentence for each of the most common reasons to hover, and for other flight nodes."""
        vehicles_by: dict[str, list[str]] = {}
        for vehicle in flown:
            if vehicle.reason:
                vehicles_by.setdefault(vehicle.reason, []).append(vehicle.name)
        common = sorted(vehicles_by.items(), key=lambda item: -len(item[1]))[:REASONS]
        found = [f"{_named(vehicles, 'hover')}: {reason.rstrip('.')}." for reason, vehicles in common]
        rest = sum(map(len, vehicles_by.values())) - sum(len(vehicles) for _, vehicles in common)
        return [*found, *([f"{rest} more hover for other reasons."] if rest else []), *self._claims(flown)]

    def _claims(self, flown: Sequence[Vehicle]) -> list[str]:
        """Return a sentence for each other flight node that flies, or wants to fly, the same vehicles."""
        leads: dict[str, list[str]] = {}
        rivals: dict[str, list[str]] = {}
        for vehicle in flown:
            if leader := self._leader(vehicle):
                leads.setdefault(leader, []).append(vehicle.name)
            elif vehicle.newest is not None and vehicle.newest.rival:
                rivals.setdefault(vehicle.newest.rival, []).append(vehicle.name)
        return [
            *(f"{_named(v, 'obey')} the flight node {n}; this one stands by." for n, v in sorted(leads.items())),
            *(f"{_named(v, 'obey')} this node; the flight node {n} claims them." for n, v in sorted(rivals.items())),
        ][:REASONS]


def require_agents(agents: Mapping[str, str], known: Sequence[str], whose: str) -> None:
    """Refuse vehicles of an agent that does not exist, and two vehicles of one agent.

    Args:
        agents: each vehicle's agent.
        known: the agents that there are.
        whose: the possessive for the error's sentence, "the policy's" for instance.

    Raises:
        ConfigError: an agent does not exist or has two vehicles.
    """
    strangers = sorted(set(agents.values()) - set(known))
    if strangers:
        raise ConfigError(f"there is no agent {strangers[0]!r}; {whose} are {', '.join(known)}.")
    if len(set(agents.values())) != len(agents):
        raise ConfigError("two vehicles have the same agent; each needs its own.")


def _target(config: FarmConfig, place: tuple[float, float], velocity: tuple[float, float]) -> tuple[float, float]:
    """Return where a velocity leads in a step, inside the field, m."""
    world = config.world
    ends = (at + speed * world.step_seconds for at, speed in zip(place, velocity, strict=True))
    x, y = (min(side, max(0.0, end)) for end, side in zip(ends, (world.field_x, world.field_y), strict=True))
    return x, y


def _named(vehicles: list[str], verb: str) -> str:
    """Return "a, b and 7 others hover", or "a hovers"."""
    if len(vehicles) == 1:
        return f"{vehicles[0]} {verb}s"
    rest = len(vehicles) - 2
    return f"{', '.join(vehicles[:2])} and {rest} others {verb}" if rest > 1 else f"{', '.join(vehicles)} {verb}"


def _spread(values: deque[float]) -> dict[str, float]:
    """Return median, 99th percentile and maximum in ms, or nothing without values."""
    if not values:
        return {}
    median, high = np.percentile(values, (50, 99))
    return {name: round(1e3 * float(x), 4) for name, x in (("median", median), ("p99", high), ("most", max(values)))}
