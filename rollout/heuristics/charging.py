"""UAVs with batteries leave for a charging station in time, and stay until the battery is nearly full.

They do not use stations in no-fly zones, and UAVs of a type do not share a station.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.farm.polygons import inside_any
from eia_sec.common.farm import farm_team
from eia_sec.rollout.sim.batch import FarmBatch
from eia_sec.rollout.sim.boxes import Array
from eia_sec.rollout.sim.core.constants import constants
from eia_sec.rollout.sim.core.motion import flight_power
from eia_sec.rollout.sim.stations import station_places

RESERVE: Final = 0.2
"""Share of the capacity that heuristics keep for the station."""
FULL: Final = 0.9
"""Share of the capacity with which a UAV leaves the station."""


class Charging:
    """Which UAVs of each environment are at a station, or on the way to one.

    Args:
        config: the farm.
        reserve: share of the capacity that should be left at the station.
    """

    def __init__(self, config: FarmConfig, reserve: float = RESERVE) -> None:
        world, numbers = config.world, constants(config)
        self._capacity, self._reserve = config.battery.capacity, reserve
        self._stations = station_places(config)
        self._types = farm_team(config).agent_slices()
        self._usable: NDArray[np.bool_] = np.ones((0, len(self._stations)), np.bool_)
        self._taken: NDArray[np.int64] = np.full((0, world.uavs), -1)
        speed = min(world.speed_x_max, world.speed_y_max)
        per_metre = [(flight_power(numbers.flight, speed) + payload) / speed for payload in numbers.fleet.payloads]
        self._per_metre = np.repeat(per_metre, world.counts)

    def reset(self, farms: FarmBatch, index: int) -> None:
        """Begin an episode in one environment, in which nobody charges."""
        more = max(0, index + 1 - len(self._taken))
        self._usable = np.pad(self._usable, ((0, more), (0, 0)))
        self._taken = np.pad(self._taken, ((0, more), (0, 0)))
        self._usable[index] = ~inside_any(self._stations, farms.layout(index).zones)
        self._taken[index] = -1

    def redirect(self, farms: FarmBatch, indices: NDArray[np.int64], goals: Array) -> None:
        """Replace the goals [k, n, 2] m of UAVs that charge, or have to, in some environments.

        Call it once a step: whoever has left for a station goes on until the battery is nearly full.
        """
        gone, charge, taken = farms.gone[indices], farms.charge[indices], self._taken[indices]
        taken[gone | (charge >= FULL * self._capacity)] = -1
        away = np.linalg.norm(self._stations - farms.position[indices][:, :, None], axis=-1)
        away[np.broadcast_to(~self._usable[indices][:, None], away.shape)] = np.inf
        due = self._due(charge, self._free(away, taken)) & (taken < 0) & ~gone
        for row, rows in ((row, rows) for row in np.flatnonzero(due.any(axis=1)) for rows in self._types):
            if due[row, rows].any():
                able = rows.start + np.flatnonzero(~gone[row, rows] & (taken[row, rows] < 0))
                order = np.argsort(charge[row, able], kind="stable")
                self._choose(able[order], charge[row], away[row], taken[row])
        self._taken[indices] = taken
        charging = taken >= 0
        goals[charging] = self._stations[taken[charging]]

    def at_stake(self, farms: FarmBatch, indices: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Return which UAVs that have a station would reach it with less than half of the reserve, [k, n]."""
        taken = self._taken[indices]  # -1 for none, whose way to the last station counts for nothing
        way = np.linalg.norm(self._stations[taken] - farms.position[indices], axis=-1)
        left = farms.charge[indices] - self._per_metre * way
        return np.asarray((taken >= 0) & (left < 0.5 * self._reserve * self._capacity))

    def _free(self, away: Array, taken: NDArray[np.int64]) -> Array:
        """Return the distances [k, n, K] m from the stations, infinite from those that UAVs of the type have."""
        held = taken[..., None] == np.arange(len(self._stations))
        of_type = [held[:, rows].any(axis=1, keepdims=True) for rows in self._types]
        counts = [rows.stop - rows.start for rows in self._types]
        return np.where(np.repeat(np.concatenate(of_type, axis=1), counts, axis=1), np.inf, away)

    def _due(self, charge: Array, free: Array) -> NDArray[np.bool_]:
        """Return who has to leave for the nearest free station now, [k, n]; nobody for whom none is free."""
        left = charge - self._per_metre * free.min(axis=-1)
        due: NDArray[np.bool_] = np.isfinite(left) & (left < self._reserve * self._capacity)
        return due

    def _choose(self, uavs: NDArray[np.int64], charge: Array, away: Array, taken: NDArray[np.int64]) -> None:
        """Let UAVs of a type that are due choose stations, one after the other.

        Args:
            uavs: those that fly and have no station, the ones with the least charge first.
            charge: [n] J.
            away: [n, K] distances from the stations, m; infinite from those of no use.
            taken: [n] stations that UAVs have, -1 for none; those chosen are written into it.
        """
        for u in uavs.tolist():
            free = self._free(away[None], taken[None])
            if self._due(charge[None], free)[0, u]:
                taken[u] = int(free[0, u].argmin())
