"""Simulated vehicles: each UAV of a farm publishes its observations and obeys its set-points."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.errors import BusError
from eia_sec.common.process import StopSignal
from eia_sec.common.protocol.messages import SetpointMessage
from eia_sec.common.team import Float32, TeamSpec
from eia_sec.common.transitions import EpisodeSummary
from eia_sec.deploy.flight.vehicle import VehicleLink
from eia_sec.rollout.evaluation import episode_seed
from eia_sec.rollout.heuristics.farms import make_farms

RESEND_SECONDS: Final = 0.5
"""Time without an answer after which a vehicle publishes its observation again: messages may be lost."""
LOOK_SECONDS: Final = 0.0005
"""Seconds between two checks for set-points."""


@dataclass
class Flight:
    """The result of one simulated flight.

    Attributes:
        summary: the episode's summary.
        actions: the environment's actions [2 n] float32 of each step, as received.
        round_trips: seconds from publishing an observation to its set-point, for each vehicle and step.
        hovers: hover set-points received while the simulator waited; no simulated time passes.
        resent: observations that were published again.
    """

    summary: EpisodeSummary
    actions: list[Float32] = field(default_factory=list)
    round_trips: list[float] = field(default_factory=list)
    hovers: int = 0
    resent: int = 0


class SimulatedFleet:
    """Flies one episode over the bus.

    A step is taken when every UAV has the set-point that answers its observation of that step, so the result does not
    depend on the speed of the network.

    Args:
        config: the farm.
        links: for each agent, its vehicle's link.
        patience: seconds without a decision after which the flight fails.
    """

    def __init__(self, config: FarmConfig, links: Mapping[str, VehicleLink], patience: float = 30.0) -> None:
        self._farms = make_farms(config, 1)
        self._links, self._patience = links, patience
        self._speed = np.array([config.world.speed_x_max, config.world.speed_y_max])

    def fly(self, farm: int, episode: int, stop: StopSignal, steps: int | None = None) -> Flight:
        """Fly an evaluation episode or its first steps; end early if stopped.

        Raises:
            BusError: no set-point has arrived for too long.
        """
        farms = self._farms
        farms.reset(0, farm, episode_seed(farm, episode))
        flight = Flight(farms.summary(0))
        most = farms.config.world.steps if steps is None else min(steps, farms.config.world.steps)
        for _ in range(most):
            velocity = self._decided(flight, stop)
            if velocity is None:
                break
            action = (velocity / self._speed).astype(np.float32).reshape(1, -1)
            farms.step(action)
            flight.actions.append(action[0])
        flight.summary = farms.summary(0)
        return flight

    def _decided(self, flight: Flight, stop: StopSignal) -> NDArray[np.float64] | None:
        """Publish all observations and return the answering velocities [agents, 2] in m/s, or None if stopped."""
        team = self._farms.team
        seen = dict(zip(team.agent_names, _each(self._farms.observation[0], team), strict=True))
        began = resent = time.monotonic()
        first = {agent: self._links[agent].observe(values) for agent, values in seen.items()}
        found: dict[str, SetpointMessage] = {}
        while len(found) < len(seen):
            if stop:
                return None
            for agent in seen.keys() - found.keys():
                for message in self._links[agent].setpoints():
                    flight.hovers += message.hover
                    if not message.hover and message.answers >= first[agent]:
                        found[agent] = message
                        flight.round_trips.append(time.monotonic() - began)
            now = time.monotonic()
            if now - began > self._patience:
                missing = sorted(seen.keys() - found.keys())
                raise BusError(
                    f"no set-point for {', '.join(missing)} within {self._patience:.0f} s; is a flight node running?"
                )
            if now - resent > RESEND_SECONDS:
                resent = now
                for agent in seen.keys() - found.keys():
                    self._links[agent].repeat()
                    flight.resent += 1
            stop.event.wait(LOOK_SECONDS)
        return np.array([found[agent].velocity for agent in team.agent_names])


def _each(row: Float32, team: TeamSpec) -> list[Float32]:
    """Return every agent's part of a row of observations, in row order."""
    return [agent for group in team.split_observations(row) for agent in group]
