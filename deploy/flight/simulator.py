"""The simulator in the place of real vehicles: each UAV of a farm publishes what it sees and obeys its set-points."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from common.config import FarmConfig
from common.errors import BusError
from common.process import StopSignal
from common.protocol.messages import SetpointMessage
from common.team import Float32, TeamSpec
from common.transitions import EpisodeSummary
from deploy.flight.vehicle import VehicleLink
from rollout.evaluation import episode_seed
from rollout.sim.batch import FarmBatch

RESEND_SECONDS: Final = 0.5
"""Time without an answer after which a vehicle publishes its observation once more: the path is lossy."""
LOOK_SECONDS: Final = 0.0005
"""Pause between two looks for set-points."""


@dataclass
class Flight:
    """What one simulated flight came to.

    Attributes:
        summary: the episode's.
        actions: [A] float32 of each step, as they came over the path.
        round_trips: seconds from publishing an observation to its set-point, for each vehicle and step.
        hovers: set-points that commanded hover while the simulator waited; no simulated time passes in them.
        resent: observations that were published once more.
    """

    summary: EpisodeSummary
    actions: list[Float32] = field(default_factory=list)
    round_trips: list[float] = field(default_factory=list)
    hovers: int = 0
    resent: int = 0


class SimulatedFleet:
    """Flies one episode over the path.

    A step is made when every UAV has the set-point that answers its observation of that step, so that the course does
    not depend on how fast the path is.

    Args:
        config: the farm.
        links: for each agent, its vehicle's link.
        patience: seconds without any decision after which the flight is given up.
    """

    def __init__(self, config: FarmConfig, links: Mapping[str, VehicleLink], patience: float = 30.0) -> None:
        self._farms = FarmBatch(config, 1)
        self._links, self._patience = links, patience
        self._speed = np.array([config.world.speed_x_max, config.world.speed_y_max])

    def fly(self, farm: int, episode: int, stop: StopSignal, steps: int | None = None) -> Flight:
        """Fly an evaluation episode, or its first steps; it ends early when told to stop.

        Raises:
            BusError: when no set-point comes for too long.
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
        """Publish what everybody sees, and return the velocities [agents, 2] m/s that answer it, or None when told."""
        team = self._farms.team
        seen = dict(zip(team.agent_names, _each(self._farms.observation[0], team), strict=True))
        began = told = time.monotonic()
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
                raise BusError(f"no set-point for {', '.join(missing)} within {self._patience:.0f} s; does a node fly?")
            if now - told > RESEND_SECONDS:
                told = now
                for agent in seen.keys() - found.keys():
                    self._links[agent].observe(seen[agent])
                    flight.resent += 1
            stop.event.wait(LOOK_SECONDS)
        return np.array([found[agent].velocity for agent in team.agent_names])


def _each(row: Float32, team: TeamSpec) -> list[Float32]:
    """Return every agent's part of a row of observations, in row order."""
    return [agent for group in team.split_observations(row) for agent in group]
