"""Monitoring: image quality of plots and their visual data freshness counters."""

import math

from rollout.kernel.compiled import compiled
from rollout.kernel.constants import Array, CameraConstants, FleetConstants, Indices
from rollout.kernel.neighbours import is_nearest


@compiled
def plot_quality(camera: CameraConstants, x: float, y: float, column: int, row: int) -> float:
    """Return Q_plot: the share of the plot's grid cells closer than d_th to a UAV over (x, y) (W21, W22)."""
    good = 0
    for i in range(camera.grid_x):
        dx = (column + (i + 0.5) / camera.grid_x) * camera.plot_width - x
        for j in range(camera.grid_y):
            dy = (row + (j + 0.5) / camera.grid_y) * camera.plot_depth - y
            if dx * dx + dy * dy < camera.ground_square:
                good += 1
    return good / (camera.grid_x * camera.grid_y)


@compiled
def photograph(
    fleet: FleetConstants,
    camera: CameraConstants,
    position: Array,
    linked: Array,
    step: int,
    level: Array,
    due: Indices,
    utility: Array,
    taken: Indices,
) -> None:
    """Take an image of every plot, credit the good ones and update VDF (W18 to W23).

    The UAV closest to a plot's centre photographs the whole plot and is credited with VDF(t - t_step); ties go to
    the lowest index. A plot with VDF 0 that is not due needs no image: it stays at 0 either way.

    Args:
        fleet: the UAVs.
        camera: plots and cells.
        position: [n, 2] m.
        linked: [n_m + n_d] 1 where images count (W4).
        step: number of this step, from 1.
        level: [n_px, n_py] VDF; updated.
        due: [n_px, n_py] step at which VDF rises next; updated.
        utility: [n] out for these UAVs: VMUF of this step.
        taken: [n_px n_py] scratch.
    """
    successes, first, last = 0, fleet.relays, fleet.collectors
    for u in range(first, last):
        utility[u] = 0.0
        if linked[u - first] == 0.0:
            continue
        x, y = position[u]
        left, right = _span(x, camera.reach, camera.plot_width, camera.plots_x)
        low, high = _span(y, camera.reach, camera.plot_depth, camera.plots_y)
        for column in range(left, right + 1):
            centre_x = (column + 0.5) * camera.plot_width
            for row in range(low, high + 1):
                if level[column, row] == 0.0 and due[column, row] != step:
                    continue
                centre_y = (row + 0.5) * camera.plot_depth
                dx, dy = centre_x - x, centre_y - y
                if not is_nearest(position, first, last, u, centre_x, centre_y, dx * dx + dy * dy):
                    continue
                if plot_quality(camera, x, y, column, row) >= camera.threshold:
                    utility[u] += level[column, row]
                    taken[successes] = column * camera.plots_y + row
                    successes += 1
    for column in range(camera.plots_x):
        for row in range(camera.plots_y):
            if due[column, row] == step:
                level[column, row] = min(level[column, row] + 1.0, camera.level_max)
                due[column, row] += camera.cycle
    for entry in range(successes):
        level[taken[entry] // camera.plots_y, taken[entry] % camera.plots_y] = 0.0


@compiled
def _span(place: float, reach: float, size: float, plots: int) -> tuple[int, int]:
    """Return the first and last plot along an axis that a reach around a place touches."""
    low = int(max(0.0, math.floor((place - reach) / size)))
    high = int(min(plots - 1.0, math.floor((place + reach) / size)))
    return low, high
