"""Patches of stress: the cycles of the counters within change, and UAVs with tasks find them.

A counter is due at step t if t equals its phase modulo its cycle, which is shorter while a patch covers it, and always
in an area. Patches and areas do not add up: the largest growth counts. The whole team knows a patch from the step on in
which a monitoring or data collection UAV is within its radius, and areas from the start. Areas come as the growth that
they give each counter.
"""

import numpy as np
from numpy.typing import NDArray

from eia_sec.rollout.sim.kernel.arrays import Farm
from eia_sec.rollout.sim.kernel.compiler.decorators import allocation_free, inlined
from eia_sec.rollout.sim.kernel.constants import Array, Constants, Int32
from eia_sec.rollout.sim.kernel.views.maps import BLOCK, BLOCKS, block_ends

Float32 = NDArray[np.float32]
Flags = NDArray[np.bool_]


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
def next_due(step: int, phase: int, cycle: int) -> int:
    """Return the first step from this one on that equals the phase modulo the cycle."""
    return step + (phase - step) % cycle


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
    step, place, time, square = farm.step, farm.patch_place, farm.patch_time, c.stress.square
    if not _changes(time, step):
        return
    camera, due, cycles, growth = c.camera, farm.level_due, farm.plot_cycle, c.stress.growth
    soonest = step + camera.cycle
    for column in range(camera.plots_x):
        for row in range(camera.plots_y):
            x, y = (column + 0.5) * camera.plot_width, (row + 0.5) * camera.plot_depth
            covered = _covered(place, time, square, step, x, y)
            cycle = shortened(camera.cycle, cycles[2, column, row], growth, covered)
            if cycles[0, column, row] != cycle:
                cycles[0, column, row] = cycle
                due[column, row] = next_due(step, cycles[1, column, row], cycle)
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

    `usual` [3, S] holds the cycles without stress, the phases, and the growth because of areas.
    """
    soonest: int = step + usual[0, 0]
    for j in range(len(cycles)):
        covered = _covered(place, time, square, step, sensor[0, j], sensor[1, j])
        cycle = shortened(usual[0, j], usual[2, j], growth, covered)
        if cycles[j] != cycle:
            cycles[j] = cycle
            due[j] = next_due(step, usual[1, j], cycle)
        soonest = min(soonest, due[j])
    return soonest


@inlined
def find_stress(c: Constants, farm: Farm) -> None:
    """Note the patches that UAVs with tasks have found, and draw the map of those that live, and of the areas.

    Updates `patch_known` and `stressed`.
    """
    fleet, step, place, time, square = c.fleet, farm.step, farm.patch_place, farm.patch_time, c.stress.square
    known, position, anew = farm.patch_known, farm.position, _changes(farm.patch_time, farm.step)
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
            found = cycles[2, column, row] > 1
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
