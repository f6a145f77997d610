"""From vehicles' observations to set-points, with a watchdog; independent of network and clock.

    pilot.offer(vehicle, payload, attachment, now)      # everything that has arrived since the last period
    for vehicle, message in pilot.decide(now).items():  # once per period
        ...                                             # send it

The watchdog counts periods: a vehicle without a usable observation in the last `hold` periods gets a hover set-point.
"""

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from eia_sec.common.actors import TeamActors, noise_free_actions
from eia_sec.common.errors import ConfigError, ProtocolError, SchemaError
from eia_sec.common.protocol.messages import Envelope, ObservationMessage, SetpointMessage
from eia_sec.common.team import Float32
from eia_sec.deploy.flight.states import AgentStates

LARGEST: Final = 4.0
"""Largest absolute value in an observation. Scaled values lie within about [-1, 1]; far larger ones are in other
units."""
KEPT: Final = 1000
"""Newest decisions that the reported latency covers."""
ROWS: Final = 16
"""Most vehicles that a report lists one by one, hovering ones first."""
REASONS: Final = 4
"""Most reasons to hover that alarms list one by one."""
REASON: Final = 160
"""Most characters of a reason."""


@dataclass(frozen=True)
class Limits:
    """Limits of the watchdog.

    Attributes:
        hold: periods for which an observation stays valid, including the one of its arrival.
        age: largest difference between an observation's time stamp and this machine's clock, s.
    """

    hold: int = 1
    age: float = 1.0


@dataclass
class _Vehicle:
    agent: int
    place: slice
    mark: tuple[int, int] = (0, 0)
    taken: int = 0
    stamp: int = 0
    began: float = 0.0
    reason: str = "no observation has come yet"
    complaint: str = ""
    hovers: int = 0
    refused: int = 0
    missed: int = 0


class Pilot:
    """Decides for the vehicles of one team.

    Args:
        actors: the actors.
        agents: for each vehicle, the agent that flies it.
        speed: speed along x and y that an environment's action of 1 commands, m/s.
        limits: limits of the watchdog.
        clock: a monotonic clock for latencies, s.

    Attributes:
        period: periods begun.
        decisions: set-points that actors decided.
        hovers: set-points that command hover.

    Raises:
        ConfigError: an agent does not exist, or flies two vehicles.
    """

    def __init__(
        self,
        actors: TeamActors,
        agents: Mapping[str, str],
        speed: tuple[float, float],
        limits: Limits,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self._actors, self._speed, self._limits, self._clock = actors.noise_free(), speed, limits, clock
        self._names = actors.team.agent_names
        self._adapters = [group.adapters for group in actors.team.groups for _ in range(group.count)]
        places = _places(actors)
        require_agents(agents, self._names, "the policy's")
        numbers = {vehicle: self._names.index(agent) for vehicle, agent in agents.items()}
        self._vehicles = {vehicle: _Vehicle(number, places[number]) for vehicle, number in numbers.items()}
        self._row = np.zeros((1, actors.team.observation_size), np.float32)
        self._states = AgentStates(actors)
        self._latency: deque[float] = deque(maxlen=KEPT)
        self._age: deque[float] = deque(maxlen=KEPT)
        self.period = self.decisions = self.hovers = 0

    def offer(self, vehicle: str, payload: bytes, attachment: bytes, now: float) -> bool:
        """Take an observation for the coming period; return whether it is usable.

        Args:
            vehicle: the vehicle's name, from the message's key.
            payload: the observation's frame.
            attachment: the envelope's frame.
            now: seconds since 1970.
        """
        held = self._vehicles[vehicle]
        began = self._clock()
        try:
            sender, message = self._checked(vehicle, held, payload, attachment, now)
        except ProtocolError as error:
            held.refused += 1
            held.complaint = str(error)
            return False
        start, before = held.mark
        held.missed += max(0, sender.sequence - before - 1) if sender.incarnation == start else 0
        held.mark, held.taken = (sender.incarnation, sender.sequence), self.period + 1
        held.stamp, held.began, held.complaint = message.stamp, began, ""
        self._row[0, held.place] = message.values
        return True

    def decide(self, now: float) -> dict[str, SetpointMessage]:
        """Begin a period and return every vehicle's set-point for it.

        Args:
            now: seconds since 1970.
        """
        self.period += 1
        for held in self._vehicles.values():
            held.reason, held.complaint = self._objection(held, now), ""
        # All actors decide on one row, as in training, so that the actions are bit-equal to those of training.
        flying = any(not held.reason for held in self._vehicles.values())
        shares = self._shares() if flying else np.zeros((0, 2), np.float32)
        return {vehicle: self._setpoint(held, shares, now) for vehicle, held in self._vehicles.items()}

    def hover(self, reason: str) -> dict[str, SetpointMessage]:
        """Begin a period in which every vehicle hovers, for example the last one."""
        self.period += 1
        for held in self._vehicles.values():
            held.reason = reason
        return {vehicle: self._hover(held) for vehicle, held in self._vehicles.items()}

    def report(self) -> dict[str, Any]:
        """Return the pilot's metrics, as `eia_sec.common.protocol.metrics` declares them."""
        worst = sorted(self._vehicles.items(), key=lambda item: (not item[1].reason, -item[1].hovers, item[0]))
        return {
            "periods": self.period,
            "decisions": self.decisions,
            "hovers": self.hovers,
            "refused": sum(held.refused for held in self._vehicles.values()),
            "missed": sum(held.missed for held in self._vehicles.values()),
            "latency": _spread(self._latency),
            "age": _spread(self._age),
            "vehicles": {
                vehicle: {
                    "agent": self._names[held.agent],
                    "hovers": held.hovers,
                    "refused": held.refused,
                    "reason": held.reason,
                }
                for vehicle, held in worst[:ROWS]
            },
            "alarms": self._alarms(),
        }

    def _shares(self) -> Float32:
        """Return every agent's velocity [agents, 2] as shares of full speed; NaN where an output is not finite."""
        state = self._states.begin({held.agent: held.mark for held in self._vehicles.values()})
        parts = list(self._actors.outputs(self._row, state))
        shares = self._actors.team.adapt(self._row, noise_free_actions(parts))[0].reshape(-1, 2)
        # The largest of logits that are not finite has an index like any other, and tanh of infinity is 1.
        finite = np.concatenate([np.isfinite(outputs[0]).all(axis=-1) for _, _, outputs in parts])
        return np.where(finite[:, None], shares, np.float32(np.nan))

    def _checked(
        self, vehicle: str, held: _Vehicle, payload: bytes, attachment: bytes, now: float
    ) -> tuple[Envelope, ObservationMessage]:
        sender, message = Envelope.decode(attachment), ObservationMessage.decode(payload)
        if (sender.role, sender.name) != ("vehicle", vehicle):
            raise ProtocolError(f"the envelope names {sender.role[:16]} {sender.name[:64]!r}.")
        # An incarnation that is invented or from a fast clock locks nobody out for longer than `age`.
        waited = message.stamp > held.stamp + self._limits.age * 1e6
        mark = sender.incarnation, sender.sequence
        repeated = mark == held.mark and message.stamp > held.stamp
        if mark <= held.mark and not (waited or repeated):
            raise ProtocolError(f"observation {sender.sequence} is not newer than {held.mark[1]}.")
        if message.agent != self._names[held.agent]:
            raise SchemaError(f"it is for agent {message.agent[:64]!r}, not {self._names[held.agent]}.")
        wanted = held.place.stop - held.place.start
        if message.values.shape != (wanted,):
            raise SchemaError(f"it has the shape {list(message.values.shape)}, not [{wanted}].")
        if not (np.abs(message.values) <= LARGEST).all():
            raise SchemaError(f"a number is not finite or larger than {LARGEST:g}; is it scaled?")
        for adapter in self._adapters[held.agent]:
            if complaint := adapter.complaint(message.values):
                raise SchemaError(complaint)
        if (objection := self._stale(message.stamp, now)) is not None:
            raise ProtocolError(objection)
        return sender, message

    def _stale(self, stamp: int, now: float) -> str | None:
        age = now - stamp / 1e6
        if -self._limits.age <= age <= self._limits.age:
            return None
        return f"it is {age:.1f} s old" if age > 0 else f"it is {-age:.1f} s ahead of this machine's clock"

    def _objection(self, held: _Vehicle, now: float) -> str:
        """Return why a vehicle has to hover in this period, or an empty text."""
        silent = self.period - held.taken
        if held.taken and silent < self._limits.hold and (objection := self._stale(held.stamp, now)) is None:
            return ""
        elif held.complaint:
            return f"the observation cannot be used: {held.complaint}"[:REASON]
        elif not held.taken:
            return "no observation has come yet"
        elif silent < self._limits.hold:
            return f"the observation is too old: {objection}"
        return f"no observation for {silent} period{'s' if silent > 1 else ''}"

    def _setpoint(self, held: _Vehicle, shares: Float32, now: float) -> SetpointMessage:
        if held.reason:
            return self._hover(held)
        share = shares[held.agent]
        if not np.isfinite(share).all():
            held.reason = "the actor's output is not finite"
            return self._hover(held)
        self.decisions += 1
        self._states.keep(held.agent, held.mark)
        # Double precision, so that dividing by the speed recovers the actor's action exactly.
        velocity = tuple(float(part) * speed for part, speed in zip(share, self._speed, strict=True))
        latency = self._clock() - held.began
        self._latency.append(latency)
        self._age.append(now - held.stamp / 1e6)
        agent = self._names[held.agent]
        return SetpointMessage(agent, velocity, False, "", held.mark[1], held.stamp, self.period, latency)

    def _hover(self, held: _Vehicle) -> SetpointMessage:
        self.hovers += 1
        held.hovers += 1
        return SetpointMessage(self._names[held.agent], (0.0, 0.0), True, held.reason, 0, 0, self.period, 0.0)

    def _alarms(self) -> list[str]:
        """Return one sentence for each of the most common reasons to hover."""
        vehicles_by: dict[str, list[str]] = {}
        for vehicle, held in self._vehicles.items():
            if held.reason:
                vehicles_by.setdefault(held.reason, []).append(vehicle)
        common = sorted(vehicles_by.items(), key=lambda item: -len(item[1]))[:REASONS]
        found = [f"{_named(vehicles)}: {reason.rstrip('.')}." for reason, vehicles in common]
        rest = sum(map(len, vehicles_by.values())) - sum(len(vehicles) for _, vehicles in common)
        return [*found, *([f"{rest} more hover for other reasons."] if rest else [])]


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


def _named(vehicles: list[str]) -> str:
    """Return "a, b and 7 others hover"."""
    if len(vehicles) == 1:
        return f"{vehicles[0]} hovers"
    rest = len(vehicles) - 2
    return f"{', '.join(vehicles[:2])} and {rest} others hover" if rest > 1 else f"{', '.join(vehicles)} hover"


def _places(actors: TeamActors) -> list[slice]:
    """Return where each agent's observation lies in a row."""
    sizes = [group.observation_size for group in actors.team.groups for _ in range(group.count)]
    ends = np.cumsum([0, *sizes]).tolist()
    return [slice(ends[index], ends[index + 1]) for index in range(len(sizes))]


def _spread(values: deque[float]) -> dict[str, float]:
    """Return median, 99th percentile and maximum in ms, or nothing without values."""
    if not values:
        return {}
    median, high = np.percentile(values, (50, 99))
    return {name: round(1e3 * float(x), 4) for name, x in (("median", median), ("p99", high), ("most", max(values)))}
