"""From which lattice points a data collection UAV hears each sensor, listed once an episode."""

import math

from eia_sec.rollout.sim.core.compile import allocation_free
from eia_sec.rollout.sim.core.constants import FleetConstants
from eia_sec.rollout.sim.core.radio import table_chance
from eia_sec.rollout.sim.core.records import Array, Float32, Int32, Site
from eia_sec.rollout.sim.observation.constants import ViewConstants
from eia_sec.rollout.sim.observation.plans.constants import HEARD, PlanConstants


@allocation_free
def _near(place: float, reach: float, count: int, side: float) -> tuple[int, int]:
    """Return the first and the last lattice point along an axis that may be within reach of a place."""
    low = math.ceil((place - reach) * count / side - 0.5)
    high = math.floor((place + reach) * count / side - 0.5)
    return max(0, int(low)), min(count - 1, int(high))


@allocation_free
def list_points(
    fleet: FleetConstants,
    plans: PlanConstants,
    view: ViewConstants,
    sensor: Array,
    first: Int32,
    point: Site,
    chance: Float32,
) -> None:
    """List the lattice points within reach of each sensor, and how well it is heard there.

    Args:
        fleet: the field.
        plans: the lattice and the reach.
        view: the table of probabilities.
        sensor: [2, S] m.
        first: [S + 1] out: where the lattice points of each sensor begin.
        point: [M] out: the lattice points.
        chance: [M] out: the probability that the sensor's packets arrive.
    """
    columns, rows, reach = plans.columns, plans.rows, plans.reach
    limit = min(reach * reach, view.chance_limit)
    found = 0
    for j in range(sensor.shape[1]):
        first[j] = found
        west, east = _near(sensor[0, j], reach, columns, fleet.width)
        south, north = _near(sensor[1, j], reach, rows, fleet.depth)
        for column in range(west, east + 1):
            dx = (column + 0.5) * fleet.width / columns - sensor[0, j]
            for row in range(south, north + 1):
                dy = (row + 0.5) * fleet.depth / rows - sensor[1, j]
                square = dx * dx + dy * dy
                if square > limit:
                    continue
                heard = table_chance(view.chance, view.chance_scale, square)
                if heard >= HEARD:
                    point[found], chance[found] = column * rows + row, heard
                    found += 1
    first[sensor.shape[1]] = found
