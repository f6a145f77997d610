"""D_VDF and D_AoI: the quadrant around a UAV with the largest sum (W25).

Quadrants are numbered (+,+), (-,+), (-,-), (+,-); what lies level with the UAV counts to the positive side; of equal
sums the first wins; where every sum is 0 there is no direction.
"""

import math

from rollout.kernel.compiled import compiled
from rollout.kernel.constants import Array, CameraConstants, FleetConstants

DIAGONAL = math.sqrt(0.5)


@compiled
def point(sums: Array, direction: Array) -> None:
    """Write the unit diagonal towards the largest of four sums, (0, 0) if all are 0."""
    best = 0
    for quadrant in range(1, 4):
        if sums[quadrant] > sums[best]:
            best = quadrant
    if sums[best] > 0.0:
        direction[0] = DIAGONAL if best in (0, 3) else -DIAGONAL
        direction[1] = DIAGONAL if best in (0, 1) else -DIAGONAL
    else:
        direction[0], direction[1] = 0.0, 0.0


@compiled
def sum_sensors(fleet: FleetConstants, position: Array, sensor: Array, age: Array, sums: Array) -> None:
    """Sum AoI over the sensors in each quadrant around every data collection UAV into its row of sums [n, 4]."""
    for u in range(fleet.collectors, len(position)):
        x, y = position[u]
        everything, right, upper, both = 0.0, 0.0, 0.0, 0.0
        for j in range(len(age)):
            east = age[j] if sensor[0, j] >= x else 0.0
            everything += age[j]
            right += east
            upper += age[j] if sensor[1, j] >= y else 0.0
            both += east if sensor[1, j] >= y else 0.0
        sums[u, 0] = both
        sums[u, 1] = upper - both
        sums[u, 2] = everything - upper - right + both
        sums[u, 3] = right - both


@compiled
def sum_plots(
    fleet: FleetConstants, camera: CameraConstants, position: Array, level: Array, integral: Array, sums: Array
) -> None:
    """Sum VDF over the plot centres in each quadrant around every monitoring UAV into its row of sums [n, 4].

    Args:
        fleet: the UAVs.
        camera: the plots.
        position: [n, 2] m.
        level: [n_px, n_py] VDF.
        integral: [n_px + 1, n_py + 1] scratch: sums over all plots below and to the left; its border is 0.
        sums: [n, 4] out.
    """
    columns, rows = level.shape
    for column in range(columns):
        below = 0.0
        for row in range(rows):
            below += level[column, row]
            integral[column + 1, row + 1] = integral[column, row + 1] + below
    for u in range(fleet.relays, fleet.collectors):
        i = _first_centre(position[u, 0], camera.plot_width, columns)
        j = _first_centre(position[u, 1], camera.plot_depth, rows)
        left, low, corner = integral[i, rows], integral[columns, j], integral[i, j]
        sums[u, 0] = integral[columns, rows] - left - low + corner
        sums[u, 1] = left - corner
        sums[u, 2] = corner
        sums[u, 3] = low - corner


@compiled
def _first_centre(place: float, size: float, plots: int) -> int:
    """Return the first plot along an axis whose centre does not lie before a place."""
    first = int(min(float(plots), max(0.0, math.floor(place / size - 0.5))))
    while first < plots and (first + 0.5) * size < place:
        first += 1
    return first
