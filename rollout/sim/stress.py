"""The patches of stress of an episode: where, and when."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from common.config import FarmConfig
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
        plots = shortened(config, plots, within(config, place, known, plot_centres(world)))
        sensors = shortened(config, sensors, within(config, place, known, layout.sensor_xy))
    return plots, sensors


def shortened(
    config: FarmConfig, cycles: NDArray[np.int64], covered: NDArray[np.bool_] | bool = True
) -> NDArray[np.int64]:
    """Return cycles in steps, divided by the growth where a patch covers their counters."""
    return np.where(covered, np.maximum(1, cycles // config.stress.growth), cycles)


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
