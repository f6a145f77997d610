"""Monitoring: image quality of plots, and the plots' VDF counters."""

import math

from eia_sec.rollout.sim.core.arrays import Farm, Scratch
from eia_sec.rollout.sim.core.compile import allocation_free, inlined
from eia_sec.rollout.sim.core.constants import CameraConstants, Constants, FleetConstants
from eia_sec.rollout.sim.core.hindsight import note_image
from eia_sec.rollout.sim.core.neighbours import is_nearest
from eia_sec.rollout.sim.core.records import Array, Int32
from eia_sec.rollout.sim.core.tallies import add, tally_plots


@allocation_free
def plot_quality(camera: CameraConstants, x: float, y: float, column: int, row: int) -> float:
    """Return Q_plot, the share of the plot's grid cells closer than d_th to a UAV over (x, y) (W21, W22)."""
    good = 0
    for cell in range(len(camera.grid_x)):
        dx = (column + camera.grid_x[cell]) * camera.plot_width - x
        dy = (row + camera.grid_y[cell]) * camera.plot_depth - y
        good += 1 if dx * dx + dy * dy < camera.ground_square else 0
    return good / len(camera.grid_x)


@inlined
def photograph(c: Constants, farm: Farm, s: Scratch) -> None:
    """Take an image of every plot, credit the good ones and update VDF (W18 to W23).

    The UAV closest to a plot's centre photographs the whole plot and is credited with VDF(t - t_step); ties go to the
    lowest index. An image counts only if the UAV's relay is in range (W4). A plot with VDF 0 that is not due needs no
    image, because it stays at 0 either way.

    Updates `level`, `level_due`, `rising`, the tally of VDF and, if visits are tracked, `plot_visit` and `hindsight`.
    Writes `utility` of the monitoring UAVs: VMUF.
    """
    fleet, camera, position, linked, step = c.fleet, c.camera, farm.position, s.linked, farm.time[0]
    level, due, below, above, rising = farm.level, farm.level_due, farm.level_below, farm.level_above, farm.rising
    utility, taken, apart_square = farm.utility, s.item, s.apart_square
    successes, due_now = 0, rising[1] == step
    for u in range(fleet.relays, fleet.collectors):
        utility[u] = 0.0
        if linked[u - fleet.relays] == 0.0:
            continue
        left, right = span(position[u, 0], camera.reach, camera.plot_width, camera.plots_x)
        low, high = span(position[u, 1], camera.reach, camera.plot_depth, camera.plots_y)
        for column in range(left, right + 1):
            for row in range(low, high + 1):
                if level[column, row] == 0.0 and not (due_now and due[column, row] == step):
                    continue
                if _succeeds(fleet, camera, position, apart_square, u, column, row):
                    utility[u] += level[column, row]
                    taken[successes] = column * camera.plots_y + row
                    successes += 1
                    note_image(c, farm, u, column, row)
    if due_now:
        rising[1] = _rise(camera, step, level, due, c.stress.some, farm.plot_cycle)
        tally_plots(level, below, above)
    for entry in range(successes):
        column, row = taken[entry] // camera.plots_y, taken[entry] % camera.plots_y
        add(below, above, column, row, -level[column, row])
        level[column, row] = 0.0


@inlined
def _succeeds(
    fleet: FleetConstants, camera: CameraConstants, position: Array, apart_square: Array, u: int, column: int, row: int
) -> bool:
    """Return whether a UAV is the one that photographs a plot and its image is good enough."""
    x, y = position[u, 0], position[u, 1]
    centre_x, centre_y = (column + 0.5) * camera.plot_width, (row + 0.5) * camera.plot_depth
    dx, dy = centre_x - x, centre_y - y
    square = dx * dx + dy * dy
    return (
        square <= camera.centre_square
        and is_nearest(position, apart_square, fleet.relays, fleet.collectors, u, centre_x, centre_y, square)
        and plot_quality(camera, x, y, column, row) >= camera.threshold
    )


@allocation_free
def _rise(camera: CameraConstants, step: int, level: Array, due: Int32, stress: bool, cycles: Int32) -> int:
    """Raise VDF where a cycle ends; return the next step at which any VDF rises. With stress each plot has a cycle."""
    soonest = step + camera.cycle
    for column in range(camera.plots_x):
        for row in range(camera.plots_y):
            if due[column, row] == step:
                level[column, row] = min(level[column, row] + 1.0, camera.level_max)
                due[column, row] += cycles[0, column, row] if stress else camera.cycle
            soonest = min(soonest, due[column, row])
    return soonest


@allocation_free
def span(place: float, reach: float, size: float, plots: int) -> tuple[int, int]:
    """Return the first and last plot along an axis within `reach` of a place."""
    low = int(max(0.0, math.floor((place - reach) / size)))
    high = int(min(plots - 1.0, math.floor((place + reach) / size)))
    return low, high
