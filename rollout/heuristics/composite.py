"""Heuristics made of three group policies, one each for relays, monitors and collectors.

A group policy sets goals for its UAVs. `steering` flies every UAV to its goal and keeps the UAVs apart. Each
environment has its own group policies, so an episode does not depend on the rest of the batch.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from common.config import FarmConfig
from common.team import Float32
from rollout.heuristics.steering import keep_apart, loiter, loiter_speed, towards
from rollout.sim.batch import FarmBatch
from rollout.sim.boxes import Array
from rollout.sim.layout import Layout

RELAYS: Final = 0
MONITORS: Final = 1
COLLECTORS: Final = 2
"""The three types, as indices of `FarmState.agents`."""


@dataclass(frozen=True)
class FarmState:
    """One environment as a heuristic sees it.

    Attributes:
        config: the farm.
        layout: its sensors.
        seeds: farm seed and episode seed.
        agents: row slices of the relays, the monitors and the collectors.
        time: steps done.
        position: [n, 2] m.
        aoi: [S] AoI.
        vdf: [n_px n_py] VDF, plots in row-major order.
        assignment: [n_m + n_d] relay of each served UAV.
    """

    config: FarmConfig
    layout: Layout
    seeds: tuple[int, int]
    agents: tuple[slice, slice, slice]
    time: int
    position: Array
    aoi: Array
    vdf: Array
    assignment: NDArray[np.int64]

    def of(self, kind: int) -> Array:
        """Return the positions of the UAVs of a type, [n_v, 2] m."""
        return self.position[self.agents[kind]]


class GroupPolicy(Protocol):
    """Steers the UAVs of one type in one environment for one episode."""

    def goals(self, state: FarmState) -> Array:
        """Return each UAV's goal, [n_v, 2] m. A goal may take more than one step to reach."""


GroupPolicyFactory = Callable[[FarmState], GroupPolicy]
"""Makes a group policy for the episode that begins in the given state."""


class CompositePolicy:
    """Flies every environment of a batch with three group policies.

    Args:
        config: the farm.
        relays: makes the policy of the communication UAVs.
        monitors: makes the policy of the monitoring UAVs.
        collectors: makes the policy of the data collection UAVs.
    """

    def __init__(
        self,
        config: FarmConfig,
        relays: GroupPolicyFactory,
        monitors: GroupPolicyFactory,
        collectors: GroupPolicyFactory,
    ) -> None:
        self._config = config
        self._loiter = loiter_speed(config) * config.world.step_seconds
        self._make = relays, monitors, collectors
        self._layouts: dict[int, Layout] = {}
        self._seeds: dict[int, tuple[int, int]] = {}
        self._groups: dict[int, list[GroupPolicy]] = {}

    def reset(self, farms: FarmBatch, index: int) -> None:
        """Make new group policies for one environment."""
        episode = farms.summary(index)
        self._layouts[index] = farms.layout(index)
        self._seeds[index] = episode.farm, episode.episode
        state = self._farm_state(farms, index)
        self._groups[index] = [make(state) for make in self._make]

    def act(self, farms: FarmBatch) -> Float32:
        """Return the actions [E, A] of this step."""
        world, count = self._config.world, len(farms.position)
        goals = np.stack([self._goals(farms, index) for index in range(count)])
        waiting = loiter(farms.position, goals, farms.time, self._loiter)
        action = towards(farms.position, waiting, world)
        parts = [keep_apart(farms.position[:, rows], action[:, rows], world) for rows in farms.team.agent_slices()]
        return np.concatenate(parts, axis=1).reshape(count, -1).astype(np.float32)

    def _goals(self, farms: FarmBatch, index: int) -> Array:
        state = self._farm_state(farms, index)
        return np.concatenate([group.goals(state) for group in self._groups[index]])

    def _farm_state(self, farms: FarmBatch, index: int) -> FarmState:
        relays, monitors, collectors = farms.team.agent_slices()
        return FarmState(
            config=self._config,
            layout=self._layouts[index],
            seeds=self._seeds[index],
            agents=(relays, monitors, collectors),
            time=int(farms.time[index]),
            position=farms.position[index],
            aoi=farms.aoi[index],
            vdf=farms.vdf[index].reshape(-1),
            assignment=farms.assignment[index],
        )
