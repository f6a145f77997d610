"""Heuristics made of three group policies, one each for relays, monitors and collectors.

A group policy sets goals for its UAVs. `steering` flies every UAV to its goal and keeps the UAVs apart. Each
environment has its own group policies, so an episode does not depend on the rest of the batch.

Where UAVs have batteries, they leave for a station in time, whatever their group policies want (`charging`).

UAVs fly around no-fly zones (`navigation`), and none makes a move that a zone would refuse.

When UAVs fail (`farm.failures`), the others begin anew: they get new group policies for a farm that has only them. So
routes are divided among the living, and nobody reckons with a UAV that is gone.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import BatteryConfig, FailureConfig, FarmConfig
from eia_sec.common.team import Float32
from eia_sec.rollout.heuristics.charging import Charging
from eia_sec.rollout.heuristics.navigation import Navigation
from eia_sec.rollout.heuristics.steering import AWAY, LOITER_MAX, loiter, loiter_speed
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.boxes import Array
from eia_sec.rollout.sim.layout import Layout

RELAYS: Final = 0
MONITORS: Final = 1
COLLECTORS: Final = 2
"""The three types, as indices of `FarmState.agents`."""
NEAR: Final = 0.5
"""Where a UAV with inertia waits, it is at most so far from its goal along each axis, m."""
DRIFT: Final = 20
"""Steps for which it drifts one way."""


@dataclass(frozen=True)
class FarmState:
    """One environment as a heuristic sees it; UAVs that are gone are no part of it.

    Attributes:
        config: the farm, with the numbers of UAVs that are left (1 of a type of which none is).
        layout: its sensors.
        seeds: farm seed and episode seed.
        agents: row slices of the relays, the monitors and the collectors.
        time: steps done.
        position: [n, 2] m.
        aoi: [S] AoI.
        vdf: [n_px n_py] VDF, plots in row-major order.
        assignment: [n_m + n_d] relay of each served UAV; -1 without relays.
        cycles: cycles of the counters as far as known, VDF [n_px n_py] and AoI [S], steps.
        wind: of the last step along x and y, [2] over top speed; None where there is none.
        motion: velocity, acceleration and last command, [n, 6] m/s and m/s^2; [0, 6] where UAVs have no inertia.
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
    cycles: tuple[NDArray[np.int64], NDArray[np.int64]]
    wind: Array | None
    motion: Array

    def of(self, kind: int) -> Array:
        """Return the positions of the UAVs of a type, [n_v, 2] m."""
        return self.position[self.agents[kind]]


class GroupPolicy(Protocol):
    """Steers the UAVs of one type in one environment for one episode."""

    def goals(self, state: FarmState) -> Array:
        """Return each UAV's goal, [n_v, 2] m. A goal may take more than one step to reach."""


GroupPolicyFactory = Callable[[FarmState], GroupPolicy]
"""Makes a group policy for the episode, or the rest of one, that begins in the given state."""


class Waiting:
    """UAVs that stay, because they have nothing to do.

    Args:
        kind: the UAVs' type.
    """

    def __init__(self, kind: int) -> None:
        self._kind = kind

    def goals(self, state: FarmState) -> Array:
        """Return where the UAVs are, [n_v, 2] m."""
        return state.of(self._kind).copy()


@functools.lru_cache(maxsize=64)
def left_over(config: FarmConfig, living: tuple[int, int, int]) -> FarmConfig:
    """Return the farm of the UAVs that are left, given their numbers by type; its relays serve as many as they do."""
    if living == config.world.counts:
        return config
    relays, monitors, collectors = (max(1, count) for count in living)
    capacity = max(config.relay.capacity_for(config.world), -(-(monitors + collectors) // relays))
    world = replace(config.world, communication_uavs=relays, monitoring_uavs=monitors, collection_uavs=collectors)
    relay = replace(config.relay, capacity=capacity)
    return replace(config, world=world, relay=relay, failures=FailureConfig(), battery=BatteryConfig())


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
        self._gone: dict[int, NDArray[np.bool_]] = {}
        self._navigation, self._charging = Navigation(config), Charging(config)

    def reset(self, farms: FarmBatch, index: int) -> None:
        """Make new group policies for one environment."""
        episode = farms.summary(index)
        self._layouts[index] = farms.layout(index)
        self._navigation.reset(farms, index)
        self._seeds[index] = episode.farm, episode.episode
        self._charging.reset(farms, index)
        self._begin(farms, index)

    def act(self, farms: FarmBatch) -> Float32:
        """Return the actions [E, A] of this step."""
        count = len(farms.position)
        return self.velocities(farms, np.arange(count)).reshape(count, -1).astype(np.float32)

    def velocities(self, farms: FarmBatch, indices: NDArray[np.int64]) -> Array:
        """Return the velocities of this step in some environments, [k, n, 2] as shares of full speed.

        Call it once a step: group policies remember what they did.
        """
        goals = np.stack([self._goals(farms, index) for index in indices.tolist()])
        if self._config.battery.some:
            self._charging.redirect(farms, indices, goals)
        position = np.where(farms.gone[indices, :, None], AWAY, farms.position[indices])
        if self._config.dynamics.inertial:
            action = self._drifting(farms, indices, goals - position)
        else:
            waiting = loiter(position, goals, farms.time[indices], self._loiter)
            action = self._navigation.towards(farms, indices, position, waiting)
        action = self._navigation.apart(farms, indices, position, action)
        return self._navigation.stopped(farms, indices, position, action)

    def _drifting(self, farms: FarmBatch, indices: NDArray[np.int64], ways: Array) -> Array:
        """Return the velocities that lead UAVs with inertia to goals; whoever stands at one drifts to and fro."""
        position = np.where(farms.gone[indices, :, None], AWAY, farms.position[indices])
        action = self._navigation.towards(farms, indices, position, position + ways)
        slow = np.abs(farms.motion[indices, :, 0:2]).max(axis=-1) < LOITER_MAX
        waits = slow & (np.abs(ways).max(axis=-1) < NEAR)
        speed = self._loiter / self._config.world.step_seconds / self._config.world.speed_x_max
        turn = np.where(farms.time[indices] // DRIFT % 2 == 0, speed, -speed)
        drift = np.stack([np.broadcast_to(turn[:, None], waits.shape), np.zeros(waits.shape)], axis=-1)
        return np.where(waits[..., None], drift, action)

    def _goals(self, farms: FarmBatch, index: int) -> Array:
        if (farms.gone[index] != self._gone[index]).any():
            self._begin(farms, index)
        state = self._farm_state(farms, index)
        goals: Array = np.full(farms.position[index].shape, AWAY)
        goals[~farms.gone[index]] = np.concatenate([group.goals(state) for group in self._groups[index]])
        return goals

    def _begin(self, farms: FarmBatch, index: int) -> None:
        """Make new group policies for the UAVs of one environment that are left."""
        self._gone[index] = farms.gone[index].copy()
        state = self._farm_state(farms, index)
        idle = [len(state.of(kind)) == 0 or (kind == RELAYS and len(state.assignment) == 0) for kind in range(3)]
        self._groups[index] = [Waiting(kind) if idle[kind] else make(state) for kind, make in enumerate(self._make)]

    def _farm_state(self, farms: FarmBatch, index: int) -> FarmState:
        left = ~farms.gone[index]
        relays, monitors, collectors = (int(left[rows].sum()) for rows in farms.team.agent_slices())
        served = farms.assignment[index][left[-farms.assignment.shape[1] :]]
        number = np.cumsum(left) - 1  # of each relay among those that are left
        wind = self._navigation.wind(farms, np.array([index]))
        return FarmState(
            config=left_over(self._config, (relays, monitors, collectors)),
            layout=self._layouts[index],
            seeds=self._seeds[index],
            agents=(
                slice(0, relays),
                slice(relays, relays + monitors),
                slice(relays + monitors, relays + monitors + collectors),
            ),
            time=int(farms.time[index]),
            position=farms.position[index][left],
            aoi=farms.aoi[index],
            vdf=farms.vdf[index].reshape(-1),
            assignment=np.where(served >= 0, number[served], -1),
            cycles=farms.known_cycles(index),
            wind=None if wind is None else wind[0, 0],
            motion=farms.motion[index][left] if self._config.dynamics.inertial else farms.motion[index],
        )
