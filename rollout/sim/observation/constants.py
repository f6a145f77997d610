"""The constants of the added observations."""

import math
import sys
from typing import Annotated, Final, NamedTuple

import numpy as np

from eia_sec.common.config import FarmConfig
from eia_sec.common.farm import COLLECTION, MONITORING, inset_of, lattice_of
from eia_sec.common.farm_observation import HOLD, farthest_stop, field_range
from eia_sec.rollout.sim.core.cells import cell_counts
from eia_sec.rollout.sim.core.link import RadioConstants, chance_at, reach_of
from eia_sec.rollout.sim.core.records import Array, Indices
from eia_sec.rollout.sim.observation.arrays import TWO_MOVES
from eia_sec.rollout.sim.sweep_routes import all_routes

SLIGHT: Final = 1e-2
"""Probability of arrival below which a sensor counts as out of reach in `units` (ours)."""
PIECES: Final = 512
"""Pieces of the table from which `units` interpolates a packet's probability of arrival (ours)."""
SAMPLES: Final = 48
"""Samples along each axis of the places around a plot (ours)."""
LEAST_LIMIT: Final = 1e-6
"""Least square of that reach, m^2; no packet arrives if it is smaller."""
RATIO: Final = 3
"""The far value field's range over the near one's; a power of one exponential is then the other (ours)."""


class ViewConstants(NamedTuple):
    """What the added observations take besides their switches."""

    some: Annotated[bool, "whether anything is added"]
    alive: Annotated[bool, "whether they see how many of their type have not failed"]
    link_range: Annotated[float, "range of the UAV-UAV link, m"]
    served: Annotated[int, "UAVs that a relay sees of those that it serves"]
    columns: Annotated[int, "lattice points along x"]
    rows: Annotated[int, "lattice points along y"]
    reach_x: Annotated[float, "distance at full speed along x in a step, as a share of the field's width"]
    reach_y: Annotated[float, "the same along y"]
    monitoring_inset: Annotated[
        float,
        "distance from a cell's border at which a monitor's move ends, as a share of the cell",
    ]
    collection_inset: Annotated[float, "the same for data collection UAVs"]
    step_x: Annotated[float, "the same along x, m"]
    step_y: Annotated[float, "the same along y, m"]
    per_hold: Annotated[float, "1 / steps of a move"]
    per_step: Annotated[float, "1 / length of a move at full speed along both axes, 1/m"]
    danger_square: Annotated[float, "square of the distance from which two UAVs risk nothing in a move, m^2"]
    first: Annotated[int, "number of the first place one move away in a plan"]
    image_sure: Annotated[
        float,
        "square of the distance to a plot's centre up to which every image succeeds, m^2; negative if none",
    ]
    image_limit: Annotated[float, "square of the distance beyond which none does, m^2; negative if none does at all"]
    image_reach: Annotated[float, "its root, m"]
    chance: Annotated[Array, "[PIECES + 2] probability of arrival at equal steps of the squared distance"]
    chance_limit: Annotated[float, "square of the distance beyond which none arrives, m^2"]
    chance_scale: Annotated[float, "pieces per square metre"]
    range: Annotated[float, "range of the far value field, m"]
    plots_x: Annotated[
        Array,
        "[2, n_px] exp(d / range) and exp(-d / range), d from the middle of the field to the plots' along x",
    ]
    plots_y: Annotated[Array, "[2, n_py] the same along y"]
    cells_x: Annotated[Array, "[2, cells_x] the same of the sensor cells"]
    cells_y: Annotated[Array, "[2, cells_y] the same along y"]
    stop_scale: Annotated[Array, "[3] longest way in which a UAV of each type stops, m"]
    age_cycles: Annotated[Array, "[I_type] T_UA of each sensor type, steps"]
    route_box: Annotated[
        Array,
        "[T, 4] the boxes of all sweep routes: least and largest x, least and largest y, m; none if not seen",
    ]
    route_plot: Annotated[Indices, "[T] their plots, row-major"]
    route_start: Annotated[Indices, "[R + 1] where each route begins"]


def view_constants(config: FarmConfig, radio: RadioConstants) -> ViewConstants:
    """Derive the numbers of the added observations."""
    seen, world, cells = config.observation, config.world, cell_counts(config.world)
    lattice = lattice_of(world)
    chance, limit = chance_table(radio, world.height_collection)
    step_x, step_y = world.speed_x_max * world.step_seconds, world.speed_y_max * world.step_seconds
    width = field_range(world)
    hold, ahead = (float(HOLD), 2.0 * HOLD) if config.dynamics.inertial else (1.0, 1.0)
    sure, most = image_bounds(config)
    boxes, plots, starts = flat_routes(config)
    return ViewConstants(
        some=seen.added or config.loses_in_flight or config.dynamics.inertial,
        alive=config.loses_in_flight,
        link_range=float(config.relay.link_range),
        served=config.relay.capacity_for(world),
        columns=lattice.columns,
        rows=lattice.rows,
        reach_x=lattice.reach_x,
        reach_y=lattice.reach_y,
        monitoring_inset=inset_of(config, MONITORING),
        collection_inset=inset_of(config, COLLECTION),
        step_x=step_x,
        step_y=step_y,
        per_hold=1.0 / hold,
        per_step=1.0 / (hold * math.hypot(step_x, step_y)),
        danger_square=(1.000001 * (world.safety_distance + 2.0 * ahead * math.hypot(step_x, step_y))) ** 2,
        first=TWO_MOVES if seen.units > 1 and not config.dynamics.inertial else 0,
        image_sure=sure,
        image_limit=most,
        image_reach=min(math.sqrt(max(most, 0.0)), math.hypot(world.field_x, world.field_y)),
        chance=chance,
        chance_limit=limit,
        chance_scale=PIECES / limit,
        range=width,
        plots_x=_exponentials(world.field_x, world.plots_x, width),
        plots_y=_exponentials(world.field_y, world.plots_y, width),
        cells_x=_exponentials(world.field_x, cells[0], width),
        cells_y=_exponentials(world.field_y, cells[1], width),
        stop_scale=np.array([farthest_stop(config.dynamics, kind) for kind in range(3)]),
        age_cycles=np.rint(np.array(world.sensor_cycles, np.float64) / world.step_seconds),
        route_box=boxes,
        route_plot=plots,
        route_start=starts,
    )


def flat_routes(config: FarmConfig) -> tuple[Array, Indices, Indices]:
    """Return the boxes [T, 4], the plots [T] and the starts [R + 1] of all R sweep routes; no boxes if none is seen."""
    world = config.world
    routes = all_routes(config) if config.observation.route else [np.zeros((2, 0, 2))] * world.monitoring_uavs
    corners = np.concatenate(routes, axis=1)
    size = np.array([world.field_x / world.plots_x, world.field_y / world.plots_y])
    column, row = (corners.mean(axis=0) // size).astype(np.int64).T
    boxes = np.ascontiguousarray(corners.transpose(1, 2, 0).reshape(-1, 4))
    starts = np.cumsum([0, *(route.shape[1] for route in routes)], dtype=np.int64)
    return boxes, column * world.plots_y + row, starts


def image_bounds(config: FarmConfig) -> tuple[float, float]:
    """Return the squares of the distances to a plot's centre that decide an image without a look at its cells, m^2.

    Up to the first every image succeeds, and beyond the second none. Quality is sampled over a quarter of the places
    around a plot. A place is at most `slack` away from a sample, so there its quality with a radius smaller or larger
    by `slack` bounds that of the place.
    """
    world, camera = config.world, config.camera
    if camera.plot_threshold == 0.0:
        return sys.float_info.max, math.inf  # the first is finite, because plots of other UAVs are infinitely far
    square = camera.image_distance**2 - world.height_monitoring**2
    if square <= 0.0:
        return -1.0, -1.0
    radius, size = math.sqrt(square), np.array([world.field_x / world.plots_x, world.field_y / world.plots_y])
    side = radius + 0.5 * float(np.hypot(*size))
    step = side / SAMPLES
    slack, places = 0.75 * step, (np.arange(SAMPLES + 1) + 0.0) * step
    x, y = (
        ((np.arange(n) + 0.5) / n - 0.5) * edge for n, edge in zip((camera.grid_x, camera.grid_y), size, strict=True)
    )
    apart = np.hypot(places[:, None, None, None] - x[:, None], places[None, :, None, None] - y)
    centre = np.hypot(places[:, None], places)
    needed = camera.plot_threshold
    surely = (apart < radius - slack).mean(axis=(2, 3)) >= needed
    possibly = (apart < radius + slack).mean(axis=(2, 3)) >= needed
    sure = centre[~surely].min() - slack
    most = centre[possibly].max(initial=-2.0 * slack) + slack
    return (float(sure) ** 2 if sure > 0.0 else -1.0), (float(most) ** 2 if most > 0.0 else -1.0)


def chance_table(radio: RadioConstants, height: float) -> tuple[Array, float]:
    """Return 1 - PLR, [PIECES + 2], and the square of the distance at the last piece's end, m^2.

    The entries are those at equal steps of the squared horizontal distance; one more allows to look ahead there.
    """
    limit = max(reach_of(radio, height, SLIGHT) ** 2, LEAST_LIMIT)
    squares = np.minimum(np.arange(PIECES + 2), PIECES) * (limit / PIECES) + height * height
    return np.array([chance_at(radio, square) for square in squares.tolist()]), limit


def _exponentials(side: float, count: int, width: float) -> Array:
    offset = ((np.arange(count) + 0.5) / count - 0.5) * side / width
    return np.stack([np.exp(offset), np.exp(-offset)])
