"""UAVs with batteries leave for a charging station in time, and stay until the battery is nearly full.

A station in a no-fly zone is none for them.
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
from rollout.sim.layout import Layout, cell_counts
from rollout.sim.stations import station_places

RESERVE: Final = 0.2
"""Share of the capacity that should be left at the station."""
FULL: Final = 0.9
"""Share of the capacity with which a UAV leaves the station."""


class Charging:
    """Which UAVs of one environment are at a station, or on the way to one. UAVs of a type do not share a station.

    Args:
        config: the farm.
        layout: its zones.
    """

    def __init__(self, config: FarmConfig, layout: Layout) -> None:
        world, numbers = config.world, constants(config, cell_counts(config.world))
        self._capacity = config.battery.capacity
        places = station_places(config)
        self._stations = places[~inside_any(places, layout.zones)]
        self._types = farm_team(config).agent_slices()
        self._taken: NDArray[np.int64] = np.full(world.uavs, -1)
        speed = min(world.speed_x_max, world.speed_y_max)
        per_metre = [(flight_power(numbers.flight, speed) + payload) / speed for payload in numbers.fleet.payloads]
        self._per_metre = np.repeat(per_metre, world.counts)

    def redirect(self, farms: FarmBatch, index: int, goals: Array) -> None:
        """Replace the goals [n, 2] m of UAVs of an environment that charge, or have to."""
        gone, charge, position = farms.gone[index], farms.charge[index], farms.position[index]
        self._taken[gone | (charge >= FULL * self._capacity)] = -1
        for rows in self._types:
            for u in np.arange(rows.start, rows.stop)[np.argsort(charge[rows])].tolist():
                if self._taken[u] < 0 and not gone[u]:
                    self._taken[u] = self._due(u, float(charge[u]), position[u], self._taken[rows])
        charging = self._taken >= 0
        goals[charging] = self._stations[self._taken[charging]]

    def _due(self, u: int, charge: float, position: Array, taken: NDArray[np.int64]) -> int:
        """Return the station for which a UAV has to leave now; -1 if there is time, or no station free."""
        away = np.linalg.norm(self._stations - position, axis=1)
        away[taken[taken >= 0]] = np.inf
        if not np.isfinite(away).any():
            return -1
        station = int(away.argmin())
        left = charge - self._per_metre[u] * away[station]
        return station if left < RESERVE * self._capacity else -1
