"""Sweep routes of monitoring UAVs: the UAVs divide the field, and each one's route goes back and forth over its part.

Source: boustrophedon coverage (Choset and Pignon 1998) over a partition of the field.
"""

import functools
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FailureConfig, FarmConfig, WorldConfig
from eia_sec.rollout.sim.boxes import Array, aim, steps_to

LANE_PLOTS: Final = 2
"""Plots side by side in a lane. A step is half a plot long, and anywhere near a plot's middle is close enough to image
it. So a UAV that weaves between two columns images a plot every step; over one column, every second step."""
SHARES: Final = np.linspace(0.0, 0.98, 50)
"""Sizes of an imaging box to try, as fractions of half a plot."""

Block = tuple[int, int, int, int]
"""First column, end column, first row and end row of a part of the field; ends are exclusive."""


@functools.lru_cache(maxsize=64)
def sweep_routes(config: FarmConfig) -> list[Array]:
    """Return the plot boxes of each monitoring UAV's part in sweep order, [2, L, 2] m each; do not change them."""
    world, boxes = config.world, plot_boxes(config)
    divisions = [
        [boxes[:, woven(block, world.plots_y)] for block in blocks]
        for blocks in divided(world.monitoring_uavs, world.plots_x, world.plots_y)
    ]
    return shortest(divisions, world)


@functools.lru_cache(maxsize=64)
def all_routes(config: FarmConfig) -> list[Array]:
    """Return the routes of all divisions that an episode can need, [2, L, 2] m each; do not change them.

    They are those of n_m monitors; or, where UAVs can be gone, those of one, of two, .. of n_m monitors.
    """
    if not config.loses_uavs:
        return sweep_routes(config)
    numbers = range(1, config.world.monitoring_uavs + 1)
    worlds = [replace(config.world, monitoring_uavs=number) for number in numbers]
    return [route for world in worlds for route in sweep_routes(replace(config, world=world, failures=FailureConfig()))]


def divided_among(config: FarmConfig, position: Array) -> NDArray[np.int64]:
    """Return the route of each of the monitors that are left, by its index in `all_routes`, and its first box, [k, 2].

    Args:
        config: the farm.
        position: of the monitors that are left, [k, 2] m.
    """
    first = len(position) * (len(position) - 1) // 2 if config.loses_uavs else 0
    routes = all_routes(config)[first : first + len(position)]
    found: NDArray[np.int64] = assigned_routes(routes, position, config.world) + np.array((first, 0))
    return found


def assigned_routes(routes: Sequence[Array], position: Array, world: WorldConfig) -> NDArray[np.int64]:
    """Return each UAV's route and the box on it that the UAV reaches first, [n, 2].

    The routes are assigned to minimise the total steps to reach them.

    Args:
        routes: one for each UAV, [2, L, 2] m.
        position: [n, 2] m.
        world: geometry and speeds.
    """
    from scipy.optimize import linear_sum_assignment  # noqa: PLC0415  (half a second that only sweep routes need)

    way = [steps_to(position[:, None], route[:, None], world) for route in routes]
    _, chosen = linear_sum_assignment(np.stack([steps.min(axis=1) for steps in way], axis=1))
    return np.array([(route, way[route][uav].argmin()) for uav, route in enumerate(chosen)], np.int64)


def divided(uavs: int, columns: int, rows: int) -> list[list[Block]]:
    """Return ways to divide columns x rows cells among UAVs: 1, 2, ... strips of columns, each cut across.

    If a strip has fewer rows than UAVs, some UAVs share a row.
    """
    ways = []
    for strips in range(1, min(uavs, columns) + 1):
        blocks = []
        for strip in range(strips):
            sharing = uavs // strips + (strip < uavs % strips)
            for part in range(sharing):
                low = part * rows // sharing
                high = max(low + 1, (part + 1) * rows // sharing)
                blocks.append((strip * columns // strips, (strip + 1) * columns // strips, low, high))
        ways.append(blocks)
    return ways


def shortest(divisions: list[list[Array]], world: WorldConfig) -> list[Array]:
    """Return the division whose longest closed route takes the fewest steps."""
    return min(divisions, key=lambda routes: max(round_steps(route, world) for route in routes))


def round_steps(route: Array, world: WorldConfig) -> int:
    """Return the steps of one lap through the boxes [2, L, 2] of a closed route."""
    length = route.shape[1]
    position, steps = route[:, 0].mean(axis=0), 0
    for at in range(1, length + 1):
        box, after = route[:, at % length], route[:, (at + 1) % length]
        steps += int(steps_to(position, box, world))
        position = aim(position, box, after, world)
    return steps


def woven(block: Block, rows: int) -> list[int]:
    """Return the plots of a block as row-major indices, in the order of a sweep back and forth between its columns.

    A lane ends on the side of the next lane.
    """
    first, last, low, high = block
    plots: list[int] = []
    for number, column in enumerate(range(first, last, LANE_PLOTS)):
        across = list(range(column, min(column + LANE_PLOTS, last)))
        along = range(low, high) if number % 2 == 0 else range(high - 1, low - 1, -1)
        for index, row in enumerate(along):
            forth = index % 2 == 0 or index == len(along) - 1
            plots += [x * rows + row for x in (across if forth else across[::-1])]
    return plots


def plot_boxes(config: FarmConfig) -> Array:
    """Return a box for each plot, in row-major order, that images it from every point: [2, n_px * n_py, 2] m.

    The box is the largest one around the plot's centre with the plot's own shape. If no place images the plot, it is a
    point.
    """
    centre, half = plot_centres(config.world), plot_half(config.world) * imaging_share(config)
    return np.stack([centre - half, centre + half])


def plot_centres(world: WorldConfig) -> Array:
    """Return the centres of all plots in row-major order, [n_px * n_py, 2] m."""
    x, y = ((np.arange(count) + 0.5) for count in (world.plots_x, world.plots_y))
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
    centres: Array = grid * 2.0 * plot_half(world)
    return centres


def plot_half(world: WorldConfig) -> Array:
    """Return half the size of a plot, [2] m."""
    return np.array([world.field_x / world.plots_x, world.field_y / world.plots_y]) / 2.0


def imaging_share(config: FarmConfig) -> float:
    """Return how far from a plot's centre every image still succeeds, as a fraction of half the plot."""
    half, far = plot_half(config.world), 0.0
    for share in SHARES:
        places = half * share * np.array([(1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
        if plot_qualities(config, places).min() < config.camera.plot_threshold:
            break
        far = float(share)
    return far


def plot_qualities(config: FarmConfig, places: Array) -> Array:
    """Return Q_plot of the images of a plot from places [K, 2] m relative to its centre, [K] (W21, W22)."""
    camera, half = config.camera, plot_half(config.world)
    counts = (camera.grid_x, camera.grid_y)
    x, y = (((np.arange(n) + 0.5) / n * 2.0 - 1.0) * side for n, side in zip(counts, half, strict=True))
    flat = (places[:, 0, None, None] - x[:, None]) ** 2 + (places[:, 1, None, None] - y) ** 2
    square = camera.image_distance**2 - config.world.height_monitoring**2
    share: Array = (flat < square).mean(axis=(1, 2))
    return share
