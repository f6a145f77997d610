"""Stress in an episode: where and when there are patches, where areas, and the cycles that both shorten."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.farm.polygons import inside
from eia_sec.common.config.farm.stress import Areas
from eia_sec.common.seeds import stream
from eia_sec.rollout.sim.boxes import Array
from eia_sec.rollout.sim.failures import NEVER
from eia_sec.rollout.sim.layout import Layout
from eia_sec.rollout.sim.sweep_routes import plot_centres

if TYPE_CHECKING:
    from eia_sec.rollout.sim.batch import FarmBatch

LATEST: Final = 0.75
"""Share of the episode within which patches appear."""


class Patches(NamedTuple):
    """The patches of an episode.

    Attributes:
        place: [P, 2] centres, m.
        time: [P, 2] first step of each patch, and the first step without it.
    """

    place: Array
    time: NDArray[np.int64]


class Counters(NamedTuple):
    """How plots' VDF and sensors' AoI rise from the first step of an episode on, before any patch appears.

    Attributes:
        plot_growth: [n_px, n_py] how many times as often areas let it rise.
        sensor_growth: [S] the same.
        plot_cycle: [n_px, n_py] steps from one rise to the next, at most NEVER.
        sensor_cycle: [S] the same.
        plot_due: [n_px, n_py] step of the first rise, at most NEVER.
        sensor_due: [S] the same.
    """

    plot_growth: NDArray[np.int64]
    sensor_growth: NDArray[np.int64]
    plot_cycle: NDArray[np.int64]
    sensor_cycle: NDArray[np.int64]
    plot_due: NDArray[np.int64]
    sensor_due: NDArray[np.int64]


@functools.lru_cache(maxsize=64)
def first_counters(config: FarmConfig, layout: Layout) -> Counters:
    """Return the counters of a farm, the same at the start of all its episodes; the arrays are read-only."""
    world, areas = config.world, config.stress.faster
    plot_growth = area_growth(areas, plot_centres(world)).reshape(layout.plot_phase.shape)
    sensor_growth = area_growth(areas, layout.sensor_xy)
    plot_cycle = shortened(np.full(plot_growth.shape, round(world.vdf_cycle / world.step_seconds)), plot_growth)
    sensor_cycle = shortened(layout.sensor_cycle_steps, sensor_growth)
    found = Counters(
        plot_growth,
        sensor_growth,
        np.minimum(plot_cycle, NEVER),
        np.minimum(sensor_cycle, NEVER),
        np.minimum(first_rises(layout.plot_phase, plot_cycle), NEVER),
        np.minimum(first_rises(layout.sensor_phase, sensor_cycle), NEVER),
    )
    for array in found:
        array.setflags(write=False)
    return found


def patches(config: FarmConfig, farm_seed: int, episode_seed: int) -> Patches:
    """Return an episode's patches: centres uniform over the field, first steps over the first three quarters."""
    world, stress = config.world, config.stress
    random = stream(farm_seed, episode_seed, "stress")
    place = random.random((stress.patches, 2)) * (world.field_x, world.field_y)
    first = random.integers(1, max(1, int(LATEST * world.steps)), stress.patches, endpoint=True)
    lasting = max(1, int(min(stress.seconds / world.step_seconds, world.steps)))
    return Patches(place, np.stack([first, first + lasting], axis=1))


def area_growth(areas: Areas, xy: Array) -> NDArray[np.int64]:
    """Return how many times as often counters at points [N, 2] m rise because of areas, [N]; 1 outside of all.

    Where areas overlap, the largest growth counts.
    """
    grown = np.ones(len(xy), np.int64)
    for growth, corners in areas:
        grown[inside(xy, np.array(corners)) & (grown < growth)] = growth
    return grown


def known_cycles(farms: FarmBatch, index: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the cycles of the counters of an environment as the team knows them, plots [P] and sensors [S], steps."""
    config, layout = farms.config, farms.layout(index)
    world, stress = config.world, config.stress
    plots = np.full(world.plots_x * world.plots_y, round(world.vdf_cycle / world.step_seconds))
    sensors = layout.sensor_cycle_steps
    if stress.some:
        first, end = farms.patch_time[index].T
        known = farms.patch_known[index] & (first <= farms.time[index]) & (farms.time[index] < end)
        place = farms.patch_place[index]
        in_patch = (within(config, place, known, xy) for xy in (plot_centres(world), layout.sensor_xy))
        in_area = farms.plot_growth[index].reshape(-1), farms.sensor_growth[index]
        plots, sensors = (
            shortened(cycles, np.where(covered, np.maximum(growth, stress.growth), growth))
            for cycles, covered, growth in zip((plots, sensors), in_patch, in_area, strict=True)
        )
    return plots, sensors


def shortened(cycles: NDArray[np.int64], growth: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return cycles in steps, divided by a growth and rounded down, to at least 1."""
    short: NDArray[np.int64] = np.maximum(1, cycles // growth)
    return short


def first_rises(phases: NDArray[np.int64], cycles: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the first step from 1 on that equals the phase modulo the cycle."""
    return 1 + (phases - 1) % cycles


def within(config: FarmConfig, place: Array, living: NDArray[np.bool_], xy: Array) -> NDArray[np.bool_]:
    """Return which of the points [N, 2] are within the radius of a living patch, [N].

    Args:
        config: the farm.
        place: [P, 2] centres of the patches, m.
        living: [P] which of them count.
        xy: [N, 2] m.
    """
    apart = ((xy[:, None] - place[living]) ** 2).sum(axis=2)
    found: NDArray[np.bool_] = (apart <= config.stress.radius**2).any(axis=1)
    return found
