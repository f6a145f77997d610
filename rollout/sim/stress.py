"""Stress in an episode: where and when there are patches, where areas, and the cycles that both shorten."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from common.config import FarmConfig
from common.config.farm.polygons import inside
from common.config.farm.stress import Areas
from common.seeds import stream
from rollout.sim.boxes import Array
from rollout.sim.sweep_routes import plot_centres

if TYPE_CHECKING:
    from rollout.sim.batch import FarmBatch

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
    return _area_growth(areas, xy.tobytes()) if areas else np.ones(len(xy), np.int64)


@functools.lru_cache(maxsize=64)
def _area_growth(areas: Areas, places: bytes) -> NDArray[np.int64]:
    """Return the growth at places; kept, because the episodes of a farm begin with the same ones."""
    xy = np.frombuffer(places).reshape(-1, 2)
    grown = np.ones(len(xy), np.int64)
    for growth, corners in areas:
        grown[inside(xy, np.array(corners)) & (grown < growth)] = growth
    grown.setflags(write=False)
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
