"""Simulated vehicles: each UAV of a farm publishes its poses and what it served, and obeys its set-points."""

import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.errors import BusError
from eia_sec.common.process import StopSignal
from eia_sec.common.protocol.messages import SetpointMessage
from eia_sec.common.team import Float32
from eia_sec.common.transitions import EpisodeSummary
from eia_sec.deploy.flight.farm_map import team_vehicles
from eia_sec.deploy.flight.vehicle import Pose, VehicleLink
from eia_sec.rollout.evaluation import episode_seed
from eia_sec.rollout.followed_farm import served_in
from eia_sec.rollout.heuristics.farms import make_farms

RESEND_SECONDS: Final = 0.2
"""Time without a decision after which a vehicle publishes its pose again: messages may be lost, and poses grow old."""
LOOK_SECONDS: Final = 0.0005
"""Seconds between two checks for set-points."""


@dataclass
class Flight:
    """The result of one simulated flight.

    Attributes:
        summary: the episode's summary.
        actions: the environment's actions [2 n] float32 of each step, as received.
        round_trips: seconds from publishing a pose to the decision on it, for each vehicle and step.
        hovers: times that a vehicle was told to hover while the simulator waited; no simulated time passes.
        resent: poses that were published again.
    """

    summary: EpisodeSummary
    actions: list[Float32] = field(default_factory=list)
    round_trips: list[float] = field(default_factory=list)
    hovers: int = 0
    resent: int = 0


class SimulatedFleet:
    """Flies one episode over the bus.

    A step is taken when every UAV has the next decision. A node in lockstep waits for the step in turn, so the result
    does not depend on the speed of the network. A node that goes by the clock decides once in each step's time; if the
    simulator is later than that, it misses decisions.

    Args:
        config: the farm.
        links: for each agent, its vehicle's link.
        patience: seconds without a decision after which the flight fails.
        monotonic: seconds that never go back.
    """

    def __init__(
        self,
        config: FarmConfig,
        links: Mapping[str, VehicleLink],
        patience: float = 30.0,
        monotonic: Callable[[], float] = time.monotonic,
    ) -> None:
        self._farms = make_farms(config, 1)
        self._links, self._patience, self._monotonic = links, patience, monotonic
        self._heights = [vehicle.height for vehicle in team_vehicles(config, {}, ())]

    def fly(self, farm: int, episode: int, stop: StopSignal, steps: int | None = None) -> Flight:
        """Fly an evaluation episode or its first steps; end early if stopped.

        Raises:
            BusError: no decision has come for too long.
        """
        farms = self._farms
        farms.reset(0, farm, episode_seed(farm, episode))
        flight = Flight(farms.summary(0))
        most = farms.config.world.steps if steps is None else min(steps, farms.config.world.steps)
        last = 0
        for _ in range(most):
            decided = self._decided(flight, last, stop)
            if decided is None:
                break
            action, last = decided
            self._step(action)
            flight.actions.append(action)
        for agent in self._links:
            self._publish([agent])
        flight.summary = farms.summary(0)
        return flight

    def _step(self, action: Float32) -> None:
        """Simulate a step, and let the vehicles know what they served in it."""
        farms = self._farms
        level, age = farms.vdf[0].copy(), farms.aoi[0].copy()
        farms.step(action[None])
        n_c, n_m, _ = farms.config.world.counts
        names = farms.team.agent_names
        for first, last, places, items in served_in(farms, level, age, n_c, n_c + n_m):
            own = farms.position[0, first:last]
            alive = np.where(farms.gone[0, first:last], np.inf, 0.0)
            apart = ((places[:, None] - own[None]) ** 2).sum(axis=2) + alive
            nearest = apart.argmin(axis=1)
            for agent in range(last - first):
                self._links[names[first + agent]].serve(items[nearest == agent].tolist())

    def _publish(self, agents: Iterable[str]) -> None:
        """Publish the poses of some agents' vehicles."""
        farms, names = self._farms, self._farms.team.agent_names
        inertial, charged = farms.config.dynamics.inertial, farms.config.battery.some
        for agent in agents:
            u = names.index(agent)
            motion = farms.motion[0, u] if inertial else np.zeros(6)
            vx, vy, ax, ay, cx, cy = motion.tolist()
            x, y = farms.position[0, u].tolist()
            wind = tuple(farms.wind[0].tolist()) if farms.config.wind.some else ()
            self._links[agent].publish(
                Pose(
                    place=(x, y),
                    height=self._heights[u],
                    velocity=(vx, vy),
                    acceleration=(ax, ay),
                    commanded=(cx, cy),
                    charge=float(farms.charge[0, u]) if charged else None,
                    wind=wind,
                    lost=bool(farms.gone[0, u]),
                )
            )

    def _decided(self, flight: Flight, last: int, stop: StopSignal) -> tuple[Float32, int] | None:
        """Publish all poses; return the decided actions [2 n] and their number, or None if stopped."""
        names = self._farms.team.agent_names
        began = resent = self._monotonic()
        self._publish(names)
        found: dict[str, SetpointMessage] = {}
        flying = [name for name, gone in zip(names, self._farms.gone[0], strict=True) if not gone]
        hovering: set[str] = set()
        while len(found) < len(flying):
            if stop:
                return None
            for agent in [name for name in flying if name not in found]:
                message = self._links[agent].setpoint()
                if not message.hover and message.decision > last:
                    found[agent] = message
                    flight.round_trips.append(self._monotonic() - began)
                elif message.hover and message.period > 0 and agent not in hovering:
                    hovering.add(agent)
                    flight.hovers += 1
            now = self._monotonic()
            if now - began > self._patience:
                missing = sorted(set(flying) - found.keys())
                why = self._links[missing[0]].setpoint().reason
                raise BusError(
                    f"no decision for {', '.join(missing)} within {self._patience:.0f} s"
                    + (f": {why}." if why else "; is a flight node running?")
                )
            if now - resent > RESEND_SECONDS:
                resent = now
                flight.resent += len(flying) - len(found)
                self._publish([name for name in flying if name not in found])
            stop.event.wait(LOOK_SECONDS)
        actions: NDArray[np.float64] = np.array([found[n].action if n in found else (0.0, 0.0) for n in names])
        return actions.astype(np.float32).ravel(), max((m.decision for m in found.values()), default=last)
