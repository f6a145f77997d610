"""D_VDF and D_AoI: the quadrant around a UAV with the largest sum (W25).

Quadrants are numbered (+,+), (-,+), (-,-), (+,-); what lies level with the UAV counts to the positive side; of equal
sums the first wins; where every sum is 0 there is no direction.
"""

import math

from rollout.kernel.compiled import compiled
from rollout.kernel.constants import Array, CameraConstants, FleetConstants, Indices, ObservationConstants
from rollout.kernel.neighbours import cell_of

DIAGONAL = math.sqrt(0.5)


@compiled
def point(fleet: FleetConstants, sums: Array, direction: Array) -> None:
    """Write for each UAV with a task the unit diagonal towards its largest sum, (0, 0) if all four are 0."""
    for u in range(fleet.relays, fleet.uavs):
        best = 0
        for quadrant in range(1, 4):
            if sums[u, quadrant] > sums[u, best]:
                best = quadrant
        length = DIAGONAL if sums[u, best] > 0.0 else 0.0
        direction[u, 0] = length if best in (0, 3) else -length
        direction[u, 1] = length if best in (0, 1) else -length


@compiled
def sum_sensors(
    fleet: FleetConstants,
    seen: ObservationConstants,
    position: Array,
    sensor: Array,
    cell_start: Indices,
    age: Array,
    integral: Array,
    sums: Array,
) -> None:
    """Sum AoI over the sensors in each quadrant around every data collection UAV into its row of sums [n, 4].

    Sensors in other columns and rows of cells than the UAV's are summed by whole cells, the others one by one.

    Args:
        fleet: the UAVs.
        seen: the sensor cells.
        position: [n, 2] m.
        sensor: [2, S] m.
        cell_start: first sensor of each cell.
        age: [S] AoI.
        integral: [cells_x + 1, cells_y + 1] scratch: sums over all cells below and to the left; its border is 0.
        sums: [n, 4] out.
    """
    columns, rows = seen.cells_x, seen.cells_y
    for column in range(columns):
        below = 0.0
        for row in range(rows):
            cell = column * rows + row
            for j in range(cell_start[cell], cell_start[cell + 1]):
                below += age[j]
            integral[column + 1, row + 1] = integral[column, row + 1] + below
    for u in range(fleet.collectors, fleet.uavs):
        x, y = position[u]
        i, k = cell_of(x / fleet.width, columns), cell_of(y / fleet.depth, rows)
        total = integral[columns, rows]
        sums[u, 0] = total - integral[i + 1, rows] - integral[columns, k + 1] + integral[i + 1, k + 1]
        sums[u, 1] = integral[i, rows] - integral[i, k + 1]
        sums[u, 2] = integral[i, k]
        sums[u, 3] = integral[columns, k] - integral[i + 1, k]
        for column in range(columns):
            low, high = (0, rows) if column == i else (k, k + 1)
            for j in range(cell_start[column * rows + low], cell_start[column * rows + high]):
                east, north = sensor[0, j] >= x, sensor[1, j] >= y
                quadrant = (0 if north else 3) if east else (1 if north else 2)
                sums[u, quadrant] += age[j]


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
