"""The observations o_c, o_m and o_d of the reference farm (W24)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from common.team import Float32

if TYPE_CHECKING:
    from rollout.reference import ReferenceFarm

Array = NDArray[np.float64]


def observe(farm: ReferenceFarm) -> Float32:
    """Return the row [O]: all relays, then all monitoring, then all data collection UAVs."""
    views = (_relay_view, _monitoring_view, _collection_view)
    rows = [np.concatenate([views[kind](farm, u), _self(farm, u)]) for u, kind in enumerate(farm.kind)]
    return np.concatenate(rows).astype(np.float32)


def _self(farm: ReferenceFarm, u: int) -> Array:
    """Return which of its type a UAV is, one of n_v, and the share of the episode that is over, where it sees these."""
    seen, mates = farm.config.observation, np.flatnonzero(farm.kind == farm.kind[u])
    rank = np.equal(mates, u).astype(np.float64) if seen.identity else np.zeros(0)
    clock = [farm.time / farm.config.world.steps] if seen.clock else []
    return np.concatenate([rank, clock])


def _own(farm: ReferenceFarm, u: int) -> Array:
    world = farm.config.world
    return np.asarray(2.0 * farm.position[u] / (world.field_x, world.field_y) - 1.0)


def _towards(farm: ReferenceFarm, u: int, place: Array) -> list[float]:
    """Return the offset over the field's sides and the 3-D distance over its diagonal to a place [3]."""
    world = farm.config.world
    dx, dy, dz = place - (*farm.position[u], farm.height[u])
    diagonal = math.hypot(world.field_x, world.field_y)
    return [dx / world.field_x, dy / world.field_y, math.sqrt(dx**2 + dy**2 + dz**2) / diagonal]


def _uav(farm: ReferenceFarm, u: int, other: int) -> list[float]:
    """Return the view of another UAV; (0, 0, 1) stands for none."""
    if other < 0:
        return [0.0, 0.0, 1.0]
    return _towards(farm, u, np.array([*farm.position[other], farm.height[other]]))


def _relay_view(farm: ReferenceFarm, u: int) -> Array:
    """Return U_c, UAV_C-c, GC_c, GC_u, UAV_f-s and UAV_N with their distances."""
    relays = [r for r in np.flatnonzero(farm.kind == 0) if r != u]
    nearest = min(relays, key=lambda r: farm.distance(u, int(r), farm.position), default=-1)
    place = np.column_stack([farm.position, farm.height])
    served = farm.served(u)
    centroid, farthest = [0.0] * 3, [0.0] * 3
    if served:
        centroid = _towards(farm, u, place[served].mean(axis=0))
        farthest = _uav(farm, u, max(served, key=lambda s: farm.distance(u, s, farm.position)))
    everybody = _towards(farm, u, place[farm.kind == 0].mean(axis=0))
    parts = (
        _own(farm, u),
        _uav(farm, u, int(nearest)),
        everybody,
        centroid,
        farthest,
        _uav(farm, u, farm.nearest_uav(u)),
    )
    return np.concatenate(parts)


def _monitoring_view(farm: ReferenceFarm, u: int) -> Array:
    """Return U_m, the window of VDF around (0 outside the field), D_VDF, UAV_N with its distance, place in the plot."""
    world, seen = farm.config.world, farm.config.observation
    size = np.array([world.field_x / world.plots_x, world.field_y / world.plots_y])
    x, y = np.minimum(farm.position[u] // size, (world.plots_x - 1, world.plots_y - 1)).astype(int)
    around = np.pad(farm.vdf, seen.window // 2)[x : x + seen.window, y : y + seen.window].reshape(-1) / world.vdf_max
    lattice = 2.0 * (farm.position[u] / size - (x, y)) - 1.0 if seen.lattice else []
    return np.concatenate([_own(farm, u), around, farm.direction[u], _uav(farm, u, farm.nearest_uav(u)), lattice])


def _collection_view(farm: ReferenceFarm, u: int) -> Array:
    """Return U_d, n sensors near (AoI and offset over 50 m, clipped), D_AoI and UAV_N with its distance."""
    seen = farm.config.observation
    offset = farm.layout.sensor_xy - farm.position[u]
    square = (offset**2).sum(axis=1)
    empty = farm.aoi < 0.5 if seen.choice == "waiting" else np.zeros(len(square), bool)
    nearest = np.lexsort((square, empty))[: seen.sensors]
    sensors = (farm.aoi[nearest] / farm.config.world.aoi_max)[:, None]
    if seen.form == "default":
        sensors = np.hstack([sensors, np.clip(offset[nearest] / 50.0, -1.0, 1.0)])
    return np.concatenate([_own(farm, u), sensors.reshape(-1), farm.direction[u], _uav(farm, u, farm.nearest_uav(u))])
