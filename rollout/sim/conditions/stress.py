"""Stress: patches that come and go and areas that stay, the cycles of counters that both shorten, and what UAVs see.

A counter is due at step t if t equals its phase modulo its cycle, which is shorter while a patch covers it, and always
in an area. Patches and areas do not add up: the largest growth counts. The whole team knows a patch from the step on in
which a monitoring or data collection UAV is within its radius, and areas from the start. Areas come as the growth that
they give each counter.
"""

import functools
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.common.config.farm.polygons import inside
from eia_sec.common.config.farm.stress import Areas
from eia_sec.common.farm_observation import BLOCK, BLOCKS
from eia_sec.common.seeds import stream
from eia_sec.rollout.sim.conditions.failures import NEVER
from eia_sec.rollout.sim.core.arrays import Farm
from eia_sec.rollout.sim.core.compile import allocation_free, inlined
from eia_sec.rollout.sim.core.constants import Constants
from eia_sec.rollout.sim.core.records import Array, Flags, Float32, Int32
from eia_sec.rollout.sim.layout import Layout
from eia_sec.rollout.sim.observation.maps import block_ends
from eia_sec.rollout.sim.sweep_routes import plot_centres

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
        plot_cycle: [n_px, n_py] steps from one rise to the next, and to the first, at most NEVER.
        sensor_cycle: [S] the same.
    """

    plot_growth: NDArray[np.int64]
    sensor_growth: NDArray[np.int64]
    plot_cycle: NDArray[np.int64]
    sensor_cycle: NDArray[np.int64]


@functools.lru_cache(maxsize=64)
def first_counters(config: FarmConfig, layout: Layout) -> Counters:
    """Return the counters of a farm, the same at the start of all its episodes; the arrays are read-only."""
    world, areas = config.world, config.stress.faster
    plot_growth = area_growth(areas, plot_centres(world)).reshape(world.plots_x, world.plots_y)
    sensor_growth = area_growth(areas, layout.sensor_xy)
    plot_cycle = shorter(np.full(plot_growth.shape, round(world.vdf_cycle / world.step_seconds)), plot_growth)
    sensor_cycle = shorter(layout.sensor_cycle_steps, sensor_growth)
    found = Counters(
        plot_growth,
        sensor_growth,
        np.minimum(plot_cycle, NEVER),
        np.minimum(sensor_cycle, NEVER),
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


def shorter(cycles: NDArray[np.int64], growth: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return cycles in steps, divided by a growth and rounded down, to at least 1."""
    short: NDArray[np.int64] = np.maximum(1, cycles // growth)
    return short


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


@allocation_free
def _lives(time: Int32, p: int, step: int) -> bool:
    alive: bool = time[p, 0] <= step < time[p, 1]
    return alive


@allocation_free
def _near(place: Array, p: int, square: float, x: float, y: float) -> bool:
    dx, dy = x - place[p, 0], y - place[p, 1]
    near: bool = dx * dx + dy * dy <= square
    return near


@allocation_free
def _covered(place: Array, time: Int32, square: float, step: int, x: float, y: float) -> bool:
    """Return whether a living patch covers a point."""
    covered = False
    for p in range(len(place)):
        covered |= _lives(time, p, step) and _near(place, p, square, x, y)
    return covered


@allocation_free
def is_known(place: Array, time: Int32, known: Flags, square: float, step: int, x: float, y: float) -> bool:
    """Return whether a living patch that the team knows covers a point."""
    covered = False
    for p in range(len(place)):
        covered |= known[p] and _lives(time, p, step) and _near(place, p, square, x, y)
    return covered


@allocation_free
def shortened(cycle: int, area: int, patch: int, covered: bool) -> int:
    """Return a cycle divided by the growth of areas, or of patches where one covers the counter and it is larger."""
    return max(1, cycle // (max(area, patch) if covered else area))


@allocation_free
def next_due(step: int, cycle: int) -> int:
    """Return the first step from this one on that is a multiple of the cycle."""
    return step + -step % cycle


@allocation_free
def _changes(time: Int32, step: int) -> bool:
    """Return whether a patch begins or ends in this step."""
    changes = False
    for p in range(len(time)):
        changes |= time[p, 0] == step or time[p, 1] == step
    return changes


@inlined
def change_cycles(c: Constants, farm: Farm) -> None:
    """Give counters the cycles that patches which begin or end in this step leave them.

    Updates `cycle`, `age_due`, `plot_cycle`, `level_due` and `rising`.
    """
    step, place, time, square = farm.time[0], farm.patch_place, farm.patch_time, c.stress.radius * c.stress.radius
    if not _changes(time, step):
        return
    camera, due, cycles, growth = c.camera, farm.level_due, farm.plot_cycle, c.stress.growth
    soonest = step + camera.cycle
    for column in range(camera.plots_x):
        for row in range(camera.plots_y):
            x, y = (column + 0.5) * camera.plot_width, (row + 0.5) * camera.plot_depth
            covered = _covered(place, time, square, step, x, y)
            cycle = shortened(camera.cycle, cycles[1, column, row], growth, covered)
            if cycles[0, column, row] != cycle:
                cycles[0, column, row] = cycle
                due[column, row] = next_due(step, cycle)
            soonest = min(soonest, due[column, row])
    farm.rising[1] = soonest
    usual, due = farm.sensor_cycle, farm.age_due
    farm.rising[0] = _change_sensors(growth, place, time, square, step, farm.sensor, usual, farm.cycle, due)


@allocation_free
def _change_sensors(
    growth: int,
    place: Array,
    time: Int32,
    square: float,
    step: int,
    sensor: Array,
    usual: Int32,
    cycles: Int32,
    due: Int32,
) -> int:
    """Give the sensors' counters their cycles; return the next step at which any AoI rises.

    `usual` [2, S] holds the cycles without stress, and the growth because of areas.
    """
    soonest: int = step + usual[0, 0]
    for j in range(len(cycles)):
        covered = _covered(place, time, square, step, sensor[0, j], sensor[1, j])
        cycle = shortened(usual[0, j], usual[1, j], growth, covered)
        if cycles[j] != cycle:
            cycles[j] = cycle
            due[j] = next_due(step, cycle)
        soonest = min(soonest, due[j])
    return soonest


@inlined
def find_stress(c: Constants, farm: Farm) -> None:
    """Note the patches that UAVs with tasks have found, and draw the map of those that live, and of the areas.

    Updates `patch_known` and `stressed`.
    """
    fleet, step, place, time, square = (
        c.fleet,
        farm.time[0],
        farm.patch_place,
        farm.patch_time,
        c.stress.radius * c.stress.radius,
    )
    known, position, anew = farm.patch_known, farm.position, _changes(farm.patch_time, farm.time[0])
    for p in range(len(place)):
        if not known[p] and _lives(time, p, step):
            for u in range(fleet.relays, fleet.uavs):
                known[p] |= _near(place, p, square, position[u, 0], position[u, 1])
            anew |= known[p]
    if anew:
        width, depth, cycles = c.camera.plot_width, c.camera.plot_depth, farm.plot_cycle
        _draw(width, depth, place, time, known, square, step, cycles, farm.stressed)


@allocation_free
def _draw(
    width: float,
    depth: float,
    place: Array,
    time: Int32,
    known: Flags,
    square: float,
    step: int,
    cycles: Int32,
    stressed: Array,
) -> None:
    """Mark the plots [n_px, n_py] in areas, which have a growth above 1, and in living patches that are known."""
    for column in range(len(stressed)):
        for row in range(stressed.shape[1]):
            found = cycles[1, column, row] > 1
            for p in range(len(place)):
                if known[p] and _lives(time, p, step):
                    found |= _near(place, p, square, (column + 0.5) * width, (row + 0.5) * depth)
            stressed[column, row] = 1.0 if found else 0.0


@allocation_free
def put_stress(stressed: Array, column: int, row: int, sx: float, sy: float, seen: Float32, at: int) -> int:
    """Write the share of stressed plots of each block around a plot; return where they end."""
    columns, rows = stressed.shape
    half = BLOCKS // 2
    for block_x in range(-half, half + 1):
        west, east = block_ends(column, sx, block_x, columns)
        for block_y in range(-half, half + 1):
            south, north = block_ends(row, sy, block_y, rows)
            amount = 0.0
            for i in range(west, east):
                for j in range(south, north):
                    amount += stressed[i, j]
            seen[at] = amount / (BLOCK * BLOCK)
            at += 1
    return at
