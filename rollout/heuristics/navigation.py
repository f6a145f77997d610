"""Ways to goals: around no-fly zones, and against the wind."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.rollout.heuristics.detours import Airspace, airspace_of
from eia_sec.rollout.heuristics.inertia import Inertia
from eia_sec.rollout.heuristics.steering import apart_ways, keep_apart, towards
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.boxes import Array, possible, reach

UNCHANGED: Final = 1e-6
"""A way that keeps apart no further than this from the wanted one is the wanted one, m."""


class Navigation:
    """Flies the UAVs of a batch of farms to goals.

    In wind, UAVs command what their top airspeed allows, as if the wind of the last step went on. UAVs with inertia fly
    so that they can stop at their goals: they judge a command by where it, and braking after it, would lead.

    Args:
        config: the farm.
    """

    def __init__(self, config: FarmConfig) -> None:
        self._config = config
        self._airspaces: dict[int, Airspace] = {}
        self._inertia = Inertia(config, np.repeat((0, 1, 2), config.world.counts)) if config.dynamics.inertial else None
        self._speed = np.array([config.world.speed_x_max, config.world.speed_y_max])

    def reset(self, farms: FarmBatch, index: int) -> None:
        """Look at the zones of an environment whose episode begins."""
        self._airspaces[index] = airspace_of(self._config, farms.layout(index))

    def wind(self, farms: FarmBatch, indices: NDArray[np.int64]) -> Array | None:
        """Return the wind in some environments over top speed, [k, 1, 2]; None if there is none."""
        world = self._config.world
        return farms.wind[indices, None] / (world.speed_x_max, world.speed_y_max) if self._config.wind.some else None

    def towards(self, farms: FarmBatch, indices: NDArray[np.int64], position: Array, goals: Array) -> Array:
        """Return the velocities that fly to goals, [k, n, 2] as shares of full speed.

        Args:
            farms: the batch.
            indices: the environments, [k].
            position: of their UAVs, [k, n, 2] m.
            goals: [k, n, 2] m.
        """
        ways = self._waypoints(farms, indices, position, goals)
        if self._inertia is not None:
            return np.asarray(self._inertia.steer(farms.motion[indices], ways - position) / self._speed)
        return towards(position, ways, self._config.world, self.wind(farms, indices))

    def _waypoints(self, farms: FarmBatch, indices: NDArray[np.int64], position: Array, goals: Array) -> Array:
        """Return where the UAVs of some environments fly first on their ways around zones, [k, n, 2] m."""
        if not self._config.zones.some:
            return goals
        ways = goals.copy()
        for row, index in enumerate(indices.tolist()):
            left = ~farms.gone[index]
            ways[row, left] = self._airspaces[index].waypoints(position[row, left], goals[row, left])
        return ways

    def apart(self, farms: FarmBatch, indices: NDArray[np.int64], position: Array, action: Array) -> Array:
        """Return the velocities without what closes in on others of the type, [k, n, 2]; see `keep_apart`."""
        world, wind = self._config.world, self.wind(farms, indices)
        if self._inertia is not None:
            motion, types = farms.motion[indices], farms.team.agent_slices()
            wanted = self._inertia.stopping_way(motion, self._commands(action))
            parts = [apart_ways(position[:, rows], wanted[:, rows], world) for rows in types]
            possible_ways = np.concatenate(parts, axis=1)
            changed = np.abs(possible_ways - wanted).max(axis=-1, keepdims=True) > UNCHANGED
            return np.where(changed, self._inertia.steer(motion, possible_ways) / self._speed, action)
        # A policy may command more than anybody can fly.
        action = np.clip(action, *possible(np.zeros(2) if wind is None else wind))
        parts = [keep_apart(position[:, rows], action[:, rows], world, wind) for rows in farms.team.agent_slices()]
        return np.concatenate(parts, axis=1)

    def stopped(self, farms: FarmBatch, indices: NDArray[np.int64], position: Array, action: Array) -> Array:
        """Return the velocities, 0 where a zone would refuse the move."""
        for row, index in enumerate(indices.tolist() if self._config.zones.some else ()):
            way = action[row].astype(np.float32) * reach(self._config.world)
            if self._inertia is not None:
                way = self._inertia.stopping_way(farms.motion[index], self._commands(action[row]))
            goal = position[row] + way
            refused = self._airspaces[index].refused(position[row], goal)
            action[row, refused & ~farms.gone[index]] = 0.0
        return action

    def _commands(self, action: Array) -> Array:
        """Return the velocities [.., n, 2] m/s that UAVs with inertia are led to by actions."""
        top = np.inf if self._inertia is None else self._inertia.top
        return np.asarray(np.clip(np.clip(action, -1.0, 1.0) * self._speed, -top, top))
