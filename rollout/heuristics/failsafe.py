"""Farms whose autopilots fly UAVs to a charging station before their batteries are empty.

PX4 and ArduPilot call this the battery failsafe (`COM_LOW_BAT_ACT`, `BATT_FS_LOW_ACT`); theirs returns to launch. The
policy gets its UAV back when the battery is nearly full. Stations are chosen as heuristics choose them (`charging`). On
the way autopilots keep apart from others of the type as heuristics do, unless less than half of the reserve would be
left. Actions are recorded as the policy gave them: to a learner, the autopilot is part of the environment.
"""

from typing import ClassVar

import numpy as np

from eia_sec.common.config import FarmConfig
from eia_sec.common.team import Float32
from eia_sec.rollout.heuristics.charging import Charging
from eia_sec.rollout.heuristics.navigation import Navigation
from eia_sec.rollout.heuristics.steering import AWAY
from eia_sec.rollout.sim.batch import FarmBatch


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
        super().step(self._corrected(action) if self._watched and self._possible(action) else action)

    def _possible(self, action: Float32) -> bool:
        """Return whether the farms will take a step with these actions; one that they refuse must change nothing."""
        under_way = (self.time >= 0) & ~self.ended
        shape = len(self.time), self.position[0].size
        well_formed = action.shape == shape and action.dtype == np.float32
        return well_formed and bool(under_way.all() and np.isfinite(action).all())

    def _corrected(self, action: Float32) -> Float32:
        """Return the actions, with autopilots' own in place of those of UAVs that charge or fly to a station."""
        goals = np.full(self.position.shape, np.nan)
        self._charging.redirect(self, np.arange(len(goals)), goals)
        some = np.flatnonzero(~np.isnan(goals[..., 0]).all(axis=1))
        if len(some) == 0:
            return action
        charging, commanded = ~np.isnan(goals[some, :, 0, None]), action.reshape(self.position.shape)
        position = np.where(self.gone[some, :, None], AWAY, self.position[some])
        straight = self._navigation.towards(self, some, position, np.where(charging, goals[some], position))
        flown = self._navigation.apart(self, some, position, np.where(charging, straight, commanded[some]))
        flown = np.where(self._charging.at_stake(self, some)[..., None], straight, flown)
        flown = self._navigation.stopped(self, some, position, flown)
        corrected = commanded.copy()
        corrected[some] = np.where(charging, flown, commanded[some])
        return corrected.reshape(action.shape)
