"""UAVs on closed routes: the group policy for heuristics that plan routes before they fly."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from eia_sec.rollout.heuristics.composite import FarmState
from eia_sec.rollout.heuristics.detours import airspace_of
from eia_sec.rollout.sim.boxes import Array, aim, inside, steps_to
from eia_sec.rollout.sim.sweep_routes import assigned_routes

PATIENCE: Final = 3
"""If another UAV blocks the way for this many steps, the UAV skips the box until the next lap."""
TURNING: Final = 12
"""The same with inertia, where turning alone takes some steps in which the UAV does not get nearer."""

STILL: Final = 0.5
"""A UAV that moved no further in a step is blocked, m."""


class TourFollower:
    """Each UAV flies laps of one route, through its boxes in order. Boxes in no-fly zones are left out.

    Args:
        routes: one for each UAV, [2, L, 2] m: lowest and highest corners of its boxes.
        kind: the UAVs' type.
        state: state at the start of the episode. Routes are assigned to minimise the total steps to reach them.
        through: whether UAVs fly on to the far side of a box, so that they need not brake before it; for inertia.
    """

    def __init__(self, routes: Sequence[Array], kind: int, state: FarmState, *, through: bool = False) -> None:
        self._kind, self._through = kind, through
        self._patience = TURNING if state.config.dynamics.inertial else PATIENCE
        self._airspace = airspace_of(state.config, state.layout)
        if self._airspace.some:
            free = [~self._airspace.inside(route.mean(axis=0)) for route in routes]
            routes = [route[:, left] if left.any() else route for route, left in zip(routes, free, strict=True)]
        chosen = assigned_routes(routes, state.of(kind), state.config.world)
        self._routes = [routes[index] for index in chosen[:, 0]]
        self._next = chosen[:, 1].copy()
        self._nearest = np.full(len(routes), np.inf)
        self._waited = np.zeros(len(routes), np.int64)
        self._before: Array = np.full((len(routes), 2), np.inf)

    def goals(self, state: FarmState) -> Array:
        """Return a place in each UAV's next box, [n_v, 2] m: on the side facing the box after it, or the far side."""
        position, world = state.of(self._kind), state.config.world
        places = np.empty_like(position)
        for uav, route in enumerate(self._routes):
            at, length = self._next[uav], route.shape[1]
            steps = float(steps_to(position[uav], route[:, at], world))  # in gusts it would rise, as if blocked
            self._waited[uav] = 0 if steps < self._nearest[uav] else self._waited[uav] + 1
            self._nearest[uav] = min(steps, self._nearest[uav])
            if inside(position[uav], route[:, at]) or self._waited[uav] >= self._patience:
                at = self._next[uav] = (at + 1) % length
                self._nearest[uav], self._waited[uav] = np.inf, 0
            places[uav] = aim(position[uav], route[:, at], route[:, (at + 1) % length], world, state.wind)
            if self._through:
                places[uav] = np.where(position[uav] < route[0, at], route[1, at], places[uav])
                places[uav] = np.where(position[uav] > route[1, at], route[0, at], places[uav])
            if self._moves(uav, position[uav]) and self._airspace.detours(position[uav], places[uav]):
                self._nearest[uav], self._waited[uav] = np.inf, 0
        self._before = position.copy()
        return places

    def _moves(self, uav: int, position: Array) -> bool:
        """Return whether a UAV among zones has moved since the last step; on a detour two can block each other."""
        return self._airspace.some and float(np.abs(position - self._before[uav]).max()) > STILL
