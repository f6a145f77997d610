"""Targets that a monitor or a collector can fly to, and the value of a visit."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from eia_sec.rollout.heuristics.composite import MONITORS, FarmState
from eia_sec.rollout.heuristics.detours import airspace_of
from eia_sec.rollout.heuristics.tasks.sites import sensor_stops
from eia_sec.rollout.sim.boxes import Array
from eia_sec.rollout.sim.sweep_routes import plot_boxes


class Targets:
    """Monitors target plots, valued by VDF. Collectors target stops, valued by the AoI of their nearest sensors.

    A target in a no-fly zone has no value.

    Args:
        state: state at the start of the episode.
        kind: the type of UAV.

    Attributes:
        box: lowest and highest corners of the box that counts as each target, [2, K, 2] m.
        centre: centres of the boxes, [K, 2] m.
    """

    def __init__(self, state: FarmState, kind: int) -> None:
        self._stop: NDArray[np.int64] | None = None
        if kind == MONITORS:
            self.box = plot_boxes(state.config)
        else:
            self.box = sensor_stops(state.config, state.layout.sensor_xy)
            _, self._stop = cKDTree(self.box.mean(axis=0)).query(state.layout.sensor_xy)
        self.centre: Array = self.box.mean(axis=0)
        self._free = ~airspace_of(state.config, state.layout).inside(self.centre)

    def value(self, state: FarmState) -> Array:
        """Return the current value of a visit to each target, [K] units."""
        if self._stop is None:
            plots: Array = state.vdf * self._free
            return plots
        value: Array = np.bincount(self._stop, state.aoi, len(self.centre)).astype(np.float64) * self._free
        return value
