"""The constants of plans: how far they look, and from which lattice points a UAV serves each plot."""

import functools
import math
from typing import Annotated, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.actions.adapters import Lattice
from eia_sec.common.config import FarmConfig
from eia_sec.common.errors import ConfigError
from eia_sec.common.farm import lattice_of
from eia_sec.rollout.sim.core.link import RadioConstants, reach_of
from eia_sec.rollout.sim.core.records import Array, Float32, Int32, Site
from eia_sec.rollout.sim.sweep_routes import plot_centres

DISCOUNT: Final = 0.98
"""Discount of a plan's rewards per step (ours)."""
HEARD: Final = 0.05
"""Least probability of arrival at which a plan reckons with a sensor's packet (ours)."""
MOST_PAIRS: Final = 2**22
"""Most lattice points, and most pairs of one and a plot or sensor that is served from there."""


class PlanConstants(NamedTuple):
    """How plans are made."""

    steps: Annotated[int, "moves that a plan looks ahead; 0 if UAVs see no plans"]
    paths: Annotated[int, "plans that the search keeps in all"]
    columns: Annotated[int, "lattice points along x"]
    rows: Annotated[int, "lattice points along y"]
    reach: Annotated[float, "distance within which a sensor's packet arrives with probability HEARD, m"]
    pairs: Annotated[int, "most pairs of sensors and lattice points within that distance"]
    most_pairs: Annotated[int, "most pairs of a plot or sensor and a lattice point from which it is served"]
    plot_x: Annotated[Array, "[P] middles of the plots along x, row-major, m"]
    plot_y: Annotated[Array, "[P] the same along y, m"]
    plot_reach: Annotated[float, "distance from a plot's middle within which its image can succeed, m"]
    plot_first: Annotated[Int32, "[P + 1] where the lattice points of each plot begin in `plot_point`"]
    plot_point: Annotated[Site, "[M] lattice points from which a plot's image succeeds; those along y are inner"]
    plot_chance: Annotated[Float32, "[M] ones"]


def plan_constants(config: FarmConfig, radio: RadioConstants, ground: float) -> PlanConstants:
    """Derive the numbers of plans.

    Args:
        config: the farm.
        radio: the radio link.
        ground: horizontal distance from a monitoring UAV beyond which it sees no cell of a plot well, m.

    Raises:
        ConfigError: there are more lattice points, or more is served from them, than plans can list.
    """
    lattice, seen, world = lattice_of(config.world), config.observation, config.world
    reach, pairs, middles = 0.0, 0, np.zeros((0, 2))
    first, point = np.zeros(1, np.int32), np.zeros(0, np.uint32)
    if seen.plan:
        reach = reach_of(radio, world.height_collection, HEARD)
        pairs = sensor_pairs(config, lattice, reach)
        if max(lattice.columns * lattice.rows, pairs, plot_pairs(config, lattice, ground)) > MOST_PAIRS:
            raise ConfigError(
                f"farm.observation.plan is for at most {MOST_PAIRS} lattice points, and pairs of one and what is "
                "served from it; here steps are too short for the field or the ranges."
            )
        middles = plot_centres(world)
        first, point = _plots_served(config, ground)
    return PlanConstants(
        steps=seen.plan,
        paths=seen.plan_paths,
        columns=lattice.columns,
        rows=lattice.rows,
        reach=reach,
        pairs=pairs,
        most_pairs=max(pairs, len(point)),
        plot_x=np.ascontiguousarray(middles[:, 0]),
        plot_y=np.ascontiguousarray(middles[:, 1]),
        plot_reach=ground + math.hypot(world.field_x / world.plots_x, world.field_y / world.plots_y),
        plot_first=first,
        plot_point=point,
        plot_chance=np.ones(len(point), np.float32),
    )


def sensor_pairs(config: FarmConfig, lattice: Lattice, reach: float) -> int:
    """Return a bound of the number of pairs of sensors and lattice points within reach of each other."""
    across = min(lattice.columns, int(2.0 * reach * lattice.columns / config.world.field_x) + 1)
    along = min(lattice.rows, int(2.0 * reach * lattice.rows / config.world.field_y) + 1)
    return config.world.sensors * across * along


def plot_pairs(config: FarmConfig, lattice: Lattice, ground: float) -> int:
    """Return a bound of the number of pairs of plots and lattice points from which a cell of the plot is seen well."""
    world = config.world
    across = min(lattice.columns, int((2.0 * ground / world.field_x + 1.0 / world.plots_x) * lattice.columns) + 1)
    along = min(lattice.rows, int((2.0 * ground / world.field_y + 1.0 / world.plots_y) * lattice.rows) + 1)
    return world.plots_x * world.plots_y * across * along


@functools.lru_cache(maxsize=8)
def _plots_served(config: FarmConfig, ground: float) -> tuple[Int32, Site]:
    """Return where the lattice points of each plot begin, [P + 1], and those from which its image succeeds, [M]."""
    world, lattice = config.world, lattice_of(config.world)
    x = (np.arange(lattice.columns) + 0.5) * world.field_x / lattice.columns
    y = (np.arange(lattice.rows) + 0.5) * world.field_y / lattice.rows
    width, depth = world.field_x / world.plots_x, world.field_y / world.plots_y
    points = []
    for plot in range(world.plots_x * world.plots_y):
        column, row = divmod(plot, world.plots_y)
        across = np.flatnonzero((x >= column * width - ground) & (x <= (column + 1) * width + ground))
        along = np.flatnonzero((y >= row * depth - ground) & (y <= (row + 1) * depth + ground))
        i, j = np.nonzero(_succeed(config, column, row, x[across], y[along]))
        points.append(across[i] * lattice.rows + along[j])
    first = np.cumsum([0, *(len(found) for found in points)])
    return first.astype(np.int32), np.concatenate(points).astype(np.uint32)


def _succeed(config: FarmConfig, column: int, row: int, x: Array, y: Array) -> NDArray[np.bool_]:
    """Return whether the image of a plot succeeds from over each place of a grid, [X, Y]."""
    world, camera = config.world, config.camera
    square = camera.image_distance**2 - world.height_monitoring**2
    cells_x = (column + (np.arange(camera.grid_x) + 0.5) / camera.grid_x) * (world.field_x / world.plots_x)
    cells_y = (row + (np.arange(camera.grid_y) + 0.5) / camera.grid_y) * (world.field_y / world.plots_y)
    dx, dy = cells_x - x[:, None], cells_y - y[:, None]
    good = (dx * dx)[:, None, :, None] + (dy * dy)[None, :, None, :] < square
    quality: Array = good.sum(axis=(2, 3)) / (camera.grid_x * camera.grid_y)
    return quality >= camera.plot_threshold
