"""UAVs with batteries leave for a charging station in time, and stay until the battery is nearly full.

They do not use stations in no-fly zones, and UAVs of a type do not share a station.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from common.config import FarmConfig
from common.config.farm.polygons import inside_any
from common.farm import farm_team
from rollout.sim.batch import FarmBatch
from rollout.sim.boxes import Array
from rollout.sim.kernel.constants import constants
from rollout.sim.kernel.flight.motion import flight_power
from rollout.sim.layout import cell_counts
from rollout.sim.stations import station_places

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
        world, numbers = config.world, constants(config, cell_counts(config.world))
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
        left = charge - self._per_metre * self._away(farms, indices, taken).min(axis=-1)
        due = np.isfinite(left) & (left < self._reserve * self._capacity) & (taken < 0) & ~gone
        for row, rows in ((row, rows) for row in np.flatnonzero(due.any(axis=1)) for rows in self._types):
            if due[row, rows].any():
                self._choose(farms, int(indices[row]), rows, taken[row, rows])
        self._taken[indices] = taken
        charging = taken >= 0
        goals[charging] = self._stations[taken[charging]]

    def _away(self, farms: FarmBatch, indices: NDArray[np.int64], taken: NDArray[np.int64]) -> Array:
        """Return how far each UAV is from each station, [k, n, K] m; infinite where another of its type has it."""
        away: Array = np.linalg.norm(self._stations - farms.position[indices][:, :, None], axis=-1)
        away[np.broadcast_to(~self._usable[indices][:, None], away.shape)] = np.inf
        held = taken[..., None] == np.arange(len(self._stations))
        for rows in self._types:
            away[:, rows][np.broadcast_to(held[:, rows].any(axis=1, keepdims=True), away[:, rows].shape)] = np.inf
        return away

    def _choose(self, farms: FarmBatch, index: int, rows: slice, taken: NDArray[np.int64]) -> None:
        """Let the UAVs of a type that are due choose stations, those with the least charge first; writes `taken`."""
        charge, position, gone = farms.charge[index, rows], farms.position[index, rows], farms.gone[index, rows]
        for u in np.argsort(charge).tolist():
            if taken[u] < 0 and not gone[u]:
                away = np.where(self._usable[index], np.linalg.norm(self._stations - position[u], axis=1), np.inf)
                away[taken[taken >= 0]] = np.inf
                left = charge[u] - self._per_metre[rows][u] * away.min()
                if np.isfinite(left) and left < self._reserve * self._capacity:
                    taken[u] = int(away.argmin())
