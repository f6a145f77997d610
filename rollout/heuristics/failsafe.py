"""Farms whose autopilots fly UAVs to a charging station in time, whatever the policy commands.

Autopilots call it the battery failsafe, or return to launch (PX4 `COM_LOW_BAT_ACT`, ArduPilot `BATT_FS_LOW_ACT`). The
policy gets its UAV back when the battery is nearly full. Stations are chosen as heuristics choose them (`charging`).
"""

from typing import ClassVar

import numpy as np

from common.config import FarmConfig
from common.team import Float32
from rollout.heuristics.charging import Charging
from rollout.heuristics.navigation import Navigation
from rollout.sim.batch import FarmBatch


class FailsafeFarms(FarmBatch):
    """Farms with `farm.battery.failsafe`; without batteries, or with 0 of it, the same as `FarmBatch`.

    Args:
        config: the farm.
        environments: E.
        threads: number of threads of the simulator; the autopilots have one.
        hindsight: as for `FarmBatch`.
    """

    failsafe: ClassVar[bool] = True

    def __init__(self, config: FarmConfig, environments: int, threads: int = 1, hindsight: bool = False) -> None:
        super().__init__(config, environments, threads, hindsight)
        self._watched = config.battery.watched
        self._charging, self._navigation = Charging(config, config.battery.failsafe), Navigation(config)

    def reset(self, index: int, farm_seed: int, episode_seed: int) -> None:
        """Start an episode in one environment; see `FarmBatch.reset`."""
        super().reset(index, farm_seed, episode_seed)
        if self._watched:
            self._charging.reset(self, index)
            self._navigation.reset(self, index)

    def step(self, action: Float32) -> None:
        """Step every environment; see `FarmBatch.step`. Autopilots replace the actions of UAVs that have to charge."""
        possible = action.shape == (len(self.time), self.position[0].size)
        super().step(self._corrected(action) if self._watched and possible else action)

    def _corrected(self, action: Float32) -> Float32:
        """Return the actions, with autopilots' own in place of those of UAVs that charge or are on the way to it."""
        under_way = np.flatnonzero((self.time >= 0) & ~self.ended)
        position = self.position[under_way]
        goals = np.full(position.shape, np.nan)
        self._charging.redirect(self, under_way, goals)
        charging = ~np.isnan(goals[..., 0])
        rows = np.flatnonzero(charging.any(axis=1))
        if len(rows) == 0:
            return action
        some, position, charging = under_way[rows], position[rows], charging[rows]
        goals = np.where(charging[..., None], goals[rows], position)
        velocity = self._navigation.towards(self, some, position, goals)
        velocity = self._navigation.stopped(self, some, position, velocity)
        corrected = action.reshape(self.position.shape).copy()
        corrected[some] = np.where(charging[..., None], velocity, corrected[some])
        return corrected.reshape(action.shape)
