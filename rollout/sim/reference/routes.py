"""The sweep route of a monitoring UAV as the reference farm observes it, written from what it means."""

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config.farm.polygons import refused
from eia_sec.common.farm_observation import ROUTE_OFFSET, ROUTE_PLOTS
from eia_sec.rollout.sim.boxes import ROUNDING, inside
from eia_sec.rollout.sim.observation.routes import PER_OFFSET, STAY
from eia_sec.rollout.sim.reference.state import FarmState
from eia_sec.rollout.sim.sweep_routes import all_routes, divided_among

Array = NDArray[np.float64]


def first_sweep(farm: FarmState) -> NDArray[np.int64]:
    """Return each monitoring UAV's route and the box on it that comes next, [n_m, 2]; zeros unless routes are seen."""
    monitors = farm.position[farm.kind == 1]
    if not farm.config.observation.route:
        return np.zeros((len(monitors), 2), np.int64)
    return divided_among(farm.config, monitors)


def divide_again(farm: FarmState) -> None:
    """Divide the field among the monitors that are left, if one was lost in the last step."""
    monitors = farm.kind == 1
    left, lost = ~farm.gone[monitors], farm.failure[monitors] == farm.time - 1
    if farm.config.observation.route and lost.any() and left.any():
        farm.sweep[left] = divided_among(farm.config, farm.position[monitors][left])


def advance(farm: FarmState) -> None:
    """Let every monitoring UAV go on to the first box of its route that is not done."""
    if farm.config.observation.route:
        for u in farm.living(1):
            monitor = u - farm.config.world.communication_uavs
            chosen, at = farm.sweep[monitor]
            farm.sweep[monitor, 1] = _next_box(farm, all_routes(farm.config)[chosen], int(at), farm.position[u])


def route_view(farm: FarmState, u: int, signs: Array, goals: Array) -> Array:
    """Return which move follows the route, and the offsets to the next plots on it.

    Args:
        farm: the farm.
        u: the UAV.
        signs: [2] of its axes.
        goals: [9, 2] where its moves lead, m.
    """
    chosen, at = farm.sweep[u - farm.config.world.communication_uavs]
    route = all_routes(farm.config)[chosen]
    box, onward = route[:, at], route[:, (at + 1) % route.shape[1]]
    gap, then = _gaps(box, goals), _gaps(onward, goals)
    cost = np.where(gap <= ROUNDING, 1e3 * then, 1e6 * gap) + ((goals - farm.position[u]) ** 2).sum(axis=1)
    cost[refused(farm.position[u], goals, farm.layout.zones)] = np.inf
    if farm.ways and np.isfinite(cost).any():
        steps = np.where(gap <= ROUNDING, 0.0, farm.ways.steps(int(_plots(farm, route)[at]), goals))
        cost[steps > steps[np.isfinite(cost)].min()] = np.inf
    ahead = route[:, (at + np.arange(ROUTE_PLOTS)) % route.shape[1]].mean(axis=0)
    offset = np.clip((ahead - farm.position[u]) * PER_OFFSET, -ROUTE_OFFSET, ROUTE_OFFSET) * signs
    chosen = cost.argmin() if np.isfinite(cost).any() else STAY
    return np.concatenate([np.arange(9) == chosen, offset.reshape(-1)])


def _next_box(farm: FarmState, route: Array, at: int, position: Array) -> int:
    """Return the first box from `at` on that is not done, and whose plot zones do not shut off.

    It is done if the UAV is in it, or if its plot is fresh while others are not.
    """
    count, plots = route.shape[1], _plots(farm, route)
    done = (farm.vdf.reshape(-1)[plots] == 0.0) & bool(farm.vdf.any())
    done[at] |= bool(inside(position, route[:, at]))
    if farm.ways:
        done |= np.array([farm.ways.is_closed(plot) for plot in plots.tolist()])
    ahead = (at + np.arange(count)) % count
    return int(ahead[int(done[ahead].argmin())])


def _plots(farm: FarmState, route: Array) -> NDArray[np.int64]:
    """Return the plots of a route's boxes, row-major."""
    size = np.array([farm.config.world.field_x, farm.config.world.field_y]) / farm.vdf.shape
    column, row = (route.mean(axis=0) // size).astype(np.int64).T
    return np.asarray(column * farm.vdf.shape[1] + row)


def _gaps(box: Array, places: Array) -> Array:
    """Return how far places [K, 2] are from a box along the worse axis, [K] m."""
    return np.asarray(np.maximum(0.0, np.maximum(box[0] - places, places - box[1])).max(axis=1))
