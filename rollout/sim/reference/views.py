"""The observations o_c, o_m and o_d of the reference farm (W24)."""

import math

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.farm import farm_team
from eia_sec.common.team import Float32
from eia_sec.rollout.sim.reference.added import added_view
from eia_sec.rollout.sim.reference.axes import place_of, plot_of, signs_of
from eia_sec.rollout.sim.reference.state import FarmState

Array = NDArray[np.float64]


def observe(farm: FarmState) -> Float32:
    """Return the row [O]: all relays, then all monitoring, then all data collection UAVs."""
    views = (_relay_view, _monitoring_view, _collection_view)
    groups = farm_team(farm.config).groups
    rows = [
        np.zeros(groups[kind].observation_size)
        if farm.gone[u]
        else np.concatenate([views[kind](farm, u), added_view(farm, u, signs_of(farm, u)), _self(farm, u)])
        for u, kind in enumerate(farm.kind)
    ]
    return np.concatenate(rows).astype(np.float32)


def _self(farm: FarmState, u: int) -> Array:
    """Return a UAV's one-hot index within its type, [n_v], and the elapsed fraction of the episode, if observed."""
    seen, mates = farm.config.observation, np.flatnonzero(farm.kind == farm.kind[u])
    rank = np.equal(mates, u).astype(np.float64) if seen.identity else np.zeros(0)
    clock = [farm.time / farm.config.world.steps] if seen.clock else []
    return np.concatenate([rank, clock])


def _own(farm: FarmState, u: int) -> Array:
    signs = signs_of(farm, u)
    return np.concatenate([place_of(farm, u) * signs, signs if farm.config.observation.mirrored else []])


def _towards(farm: FarmState, u: int, place: Array) -> list[float]:
    """Return the offset to a place [3] divided by the field's sides, and the 3-D distance divided by its diagonal."""
    world = farm.config.world
    dx, dy, dz = place - (*farm.position[u], farm.height[u])
    diagonal, (along_x, along_y) = math.hypot(world.field_x, world.field_y), signs_of(farm, u)
    return [along_x * dx / world.field_x, along_y * dy / world.field_y, math.sqrt(dx**2 + dy**2 + dz**2) / diagonal]


def _uav(farm: FarmState, u: int, other: int) -> list[float]:
    """Return the view of another UAV; (0, 0, 1) if there is none."""
    if other < 0:
        return [0.0, 0.0, 1.0]
    return _towards(farm, u, np.array([*farm.position[other], farm.height[other]]))


def _relay_view(farm: FarmState, u: int) -> Array:
    """Return U_c, then UAV_C-c, GC_c, GC_u, UAV_f-s and UAV_N with their distances."""
    relays = [r for r in farm.living(0) if r != u]
    nearest = min(relays, key=lambda r: farm.distance(u, int(r), farm.position), default=-1)
    place = np.column_stack([farm.position, farm.height])
    served = farm.served(u)
    centroid, farthest = [0.0] * 3, [0.0] * 3
    if served:
        centroid = _towards(farm, u, place[served].mean(axis=0))
        farthest = _uav(farm, u, max(served, key=lambda s: farm.distance(u, s, farm.position)))
    everybody = _towards(farm, u, place[farm.living(0)].mean(axis=0))
    parts = (
        _own(farm, u),
        _uav(farm, u, int(nearest)),
        everybody,
        centroid,
        farthest,
        _uav(farm, u, farm.nearest_uav(u)),
    )
    return np.concatenate(parts)


def _monitoring_view(farm: FarmState, u: int) -> Array:
    """Return U_m, the VDF window (0 outside the field), D_VDF, UAV_N with its distance, and the place in the plot."""
    seen, signs, ((x, y), offset) = farm.config.observation, signs_of(farm, u), plot_of(farm, u)
    around = np.pad(farm.vdf, seen.window // 2)[x : x + seen.window, y : y + seen.window] / farm.config.world.vdf_max
    turned = np.flip(around, tuple(np.flatnonzero(signs < 0.0).tolist())).reshape(-1)
    nearest, place = _uav(farm, u, farm.nearest_uav(u)), (offset * signs)[: 2 * seen.lattice]
    return np.concatenate([_own(farm, u), turned, farm.direction[u] * signs, nearest, place])


def _collection_view(farm: FarmState, u: int) -> Array:
    """Return U_d, the n nearest sensors (AoI, clipped offset over 50 m), D_AoI, and UAV_N with its distance."""
    seen, signs = farm.config.observation, signs_of(farm, u)
    offset = farm.layout.sensor_xy - farm.position[u]
    square = (offset**2).sum(axis=1)
    empty = farm.aoi < 0.5 if seen.choice == "waiting" else np.zeros(len(square), bool)
    nearest = np.lexsort((square, empty))[: seen.sensors]
    sensors = (farm.aoi[nearest] / farm.config.world.aoi_max)[:, None]
    if seen.form == "default":
        sensors = np.hstack([sensors, np.clip(offset[nearest] * signs / 50.0, -1.0, 1.0)])
    nearest_uav = _uav(farm, u, farm.nearest_uav(u))
    return np.concatenate([_own(farm, u), sensors.reshape(-1), farm.direction[u] * signs, nearest_uav])
