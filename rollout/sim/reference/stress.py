"""Stress on the reference farm: the cycles that patches and areas shorten, who knows them, and how they are seen."""

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config.farm.polygons import inside
from eia_sec.rollout.sim.conditions.stress import within
from eia_sec.rollout.sim.reference.state import FarmState

Array = NDArray[np.float64]


def living(farm: FarmState) -> NDArray[np.bool_]:
    """Return which patches there are now, [P]."""
    first, end = farm.patches.time.T
    return np.asarray((first <= farm.time) & (farm.time < end))


def growth_of_areas(farm: FarmState, xy: Array) -> NDArray[np.int64]:
    """Return the growth of points [N, 2] without patches: the largest of the areas that each lies in, at least 1."""
    growth = np.ones(len(xy), np.int64)
    for faster, corners in farm.config.stress.areas:
        growth = np.where(inside(xy, np.array(corners)), np.maximum(growth, faster), growth)
    return growth


def plot_cycles(farm: FarmState) -> NDArray[np.int64]:
    """Return the cycle of each plot's VDF in this step, [n_px, n_py] steps."""
    world = farm.config.world
    usual = np.full((world.plots_x, world.plots_y), round(world.vdf_cycle / world.step_seconds))
    return shortened(farm, usual, farm.plot_xy)


def sensor_cycles(farm: FarmState) -> NDArray[np.int64]:
    """Return the cycle of each sensor's AoI in this step, [S] steps."""
    return shortened(farm, farm.layout.sensor_cycle_steps, farm.layout.sensor_xy)


def shortened(farm: FarmState, usual: NDArray[np.int64], xy: Array) -> NDArray[np.int64]:
    """Return cycles, divided by the largest growth of the areas and living patches that points [N, 2] lie in."""
    covered = within(farm.config, farm.patches.place, living(farm), xy)
    growth = np.maximum(growth_of_areas(farm, xy), np.where(covered, farm.config.stress.growth, 1))
    return np.maximum(1, usual // growth.reshape(usual.shape))


def find(farm: FarmState) -> None:
    """Let the team know the living patches that monitoring and data collection UAVs are over."""
    uavs = farm.position[np.concatenate([farm.living(1), farm.living(2)])]
    alive = living(farm)
    for p, place in enumerate(farm.patches.place):
        over = ((uavs - place) ** 2).sum(axis=1) <= farm.config.stress.radius**2
        farm.known[p] |= alive[p] and over.any()


def stress_view(farm: FarmState, u: int, signs: Array) -> Array:
    """Return the share of plots in areas and known living patches, for 5 x 5 blocks of 4 x 4 plots around a UAV."""
    world, half, view = farm.config.world, 10, np.zeros((5, 5))
    count = np.array([world.plots_x, world.plots_y])
    seen = living(farm) & farm.known
    stressed = within(farm.config, farm.patches.place, seen, farm.plot_xy) | (growth_of_areas(farm, farm.plot_xy) > 1)
    stressed = stressed.reshape(count)
    size = np.array([world.field_x, world.field_y])
    own = np.clip(farm.position[u] / size * count, 0, count - 1).astype(np.int64)
    for index in np.ndindex(20, 20):
        i, j = own + signs.astype(np.int64) * (np.array(index) - half)
        if 0 <= i < count[0] and 0 <= j < count[1]:
            view[index[0] // 4, index[1] // 4] += stressed[i, j] / 16.0
    return view.reshape(-1)
