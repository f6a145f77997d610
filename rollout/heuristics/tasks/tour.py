"""Stops grouped by k-means, one group per UAV, and a short closed tour through each group's stops.

Source: k-means with a tour per cluster, as for data ferries; 2-opt (Croes 1958, Lin 1965).
"""

import functools
from itertools import permutations
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2

from eia_sec.common.config import WorldConfig
from eia_sec.common.seeds import stream
from eia_sec.rollout.heuristics.composite import COLLECTORS, MONITORS, FarmState, GroupPolicy
from eia_sec.rollout.heuristics.tasks.sites import sensor_stops, steps_between
from eia_sec.rollout.heuristics.tasks.tour_follower import TourFollower
from eia_sec.rollout.sim.boxes import Array
from eia_sec.rollout.sim.sweep_routes import plot_boxes, plot_centres

Indices = NDArray[np.int64]

RESTARTS: Final = 5
"""Groupings to try on each farm. The one whose longest tour is shortest wins."""
PLOT_RESTARTS: Final = 20
"""Groupings to try for plots, which are grouped once for all farms."""
STARTS: Final = 30
"""Approximate limit on the places to start a tour from."""
EASY: Final = 128
"""Tours of up to this many places get all starts and groupings. Longer ones get fewer, because the time is cubic."""
SAVING: Final = 1e-9
"""Least saving that justifies changing a tour, steps."""
STRAIGHT: Final = 0.001
"""Weight of the path length along both axes inside a block of plots, 1/m. It breaks ties against diagonals."""


def monitors(state: FarmState) -> GroupPolicy:
    """Return monitors whose stops are blocks of two by two plots. They image one plot per step."""
    boxes = plot_boxes(state.config)
    routes = [boxes[:, list(plots)] for plots in plot_tours(state.config.world)]
    return TourFollower(routes, MONITORS, state, through=state.config.dynamics.inertial)


def collectors(state: FarmState) -> GroupPolicy:
    """Return collectors whose stops are places that hear sensors well, near the monitors' areas where links count."""
    world = state.config.world
    boxes = sensor_stops(state.config, state.layout.sensor_xy)
    stops, random = boxes.mean(axis=0), stream("tour", "sensors", *state.seeds)
    tours = tours_beside_monitors(stops, world) if state.config.relay.require_link else []
    tours = tours or grouped_tours(stops, world.collection_uavs, world, random, RESTARTS)
    routes = [boxes[:, tour] for tour in tours]
    return TourFollower(routes, COLLECTORS, state, through=state.config.dynamics.inertial)


@functools.lru_cache(maxsize=8)
def plot_tours(world: WorldConfig) -> tuple[tuple[int, ...], ...]:
    """Return the plots of each monitor's tour as row-major indices. They are the same on every farm."""
    blocks, centres = plot_blocks(world), plot_centres(world)
    stops = np.array([centres[block].mean(axis=0) for block in blocks])
    tours = grouped_tours(stops, world.monitoring_uavs, world, stream("tour", "plots"), PLOT_RESTARTS)
    return tuple(tuple(plots_along([blocks[stop] for stop in tour], centres, world)) for tour in tours)


def tours_beside_monitors(stops: Array, world: WorldConfig) -> list[Indices]:
    """Return a closed tour through the stops [L, 2] nearest to each monitor's area, so that a relay can be near both.

    There are none when there are more or fewer collectors than monitors, or an area has no stop.
    """
    centres = plot_centres(world)
    middles = np.array([centres[list(plots)].mean(axis=0) for plots in plot_tours(world)])
    label = np.linalg.norm(stops[:, None] - middles, axis=2).argmin(axis=1)
    members = [np.flatnonzero(label == area) for area in range(len(middles))]
    if world.collection_uavs != len(middles) or not all(map(len, members)):
        return []
    return [member[short_tour(stops[member], world)[0]] for member in members]


def grouped_tours(
    stops: Array, uavs: int, world: WorldConfig, random: np.random.Generator, restarts: int
) -> list[Indices]:
    """Return a closed tour through part of the stops [L, 2] for each UAV. With too few stops, UAVs share one."""
    groups = min(uavs, len(stops))
    best, least = [np.array([stop]) for stop in range(groups)], np.inf
    restarts = tries(restarts, len(stops) // groups)
    for _ in range(min(restarts, len(stops) - groups) if groups > 1 else 1):
        _, label = kmeans2(stops, groups, minit="++", rng=random, missing="warn")
        members = [np.flatnonzero(label == group) for group in range(groups)]
        if min(len(member) for member in members) > 0:
            tours = [short_tour(stops[member], world) for member in members]
            longest = max(length for _, length in tours)
            if longest < least:
                best, least = [member[tour] for member, (tour, _) in zip(members, tours, strict=True)], longest
    return [best[uav % groups] for uav in range(uavs)]


def short_tour(places: Array, world: WorldConfig) -> tuple[Indices, float]:
    """Return a short closed tour through places [L, 2] and its steps: nearest neighbour, many starts, then 2-opt."""
    steps = steps_between(places, places, world)
    best, least = np.arange(len(places)), np.inf
    for start in range(0, len(places), 1 + len(places) // tries(STARTS, len(places))):
        tour = two_opt(nearest_next(steps, start), steps)
        length = float(steps[tour, np.roll(tour, -1)].sum())
        if length < least - SAVING:
            best, least = tour, length
    return best, least


def tries(most: int, places: int) -> int:
    """Return how many tries, `most` at most, a tour through this many places gets."""
    return max(1, min(most, int(STARTS * (EASY / max(1, places)) ** 3)))


def nearest_next(steps: Array, start: int) -> Indices:
    """Return the tour that always continues to the nearest unvisited place, by steps [L, L]."""
    left, tour = steps.copy(), np.empty(len(steps), np.int64)
    at = start
    for index in range(len(steps)):
        tour[index] = at
        left[:, at] = np.inf
        at = int(left[at].argmin())
    return tour


def two_opt(tour: Indices, steps: Array) -> Indices:
    """Improve a closed tour by the best exchange of two edges until no exchange helps; return it."""
    while len(tour) > 3:
        after = np.roll(tour, -1)
        edge = steps[tour, after]
        saved = edge[:, None] + edge - steps[np.ix_(tour, tour)] - steps[np.ix_(after, after)]
        np.fill_diagonal(saved, 0.0)
        low, high = sorted(int(index) for index in np.unravel_index(np.argmax(saved), saved.shape))
        if saved[low, high] <= SAVING:
            break
        tour = np.concatenate([tour[: low + 1], tour[low + 1 : high + 1][::-1], tour[high + 1 :]])
    return tour


def plot_blocks(world: WorldConfig) -> list[list[int]]:
    """Return the plots of every two-by-two block as row-major indices. Blocks at an odd border are smaller."""
    columns, rows = (
        [range(first, min(first + 2, plots)) for first in range(0, plots, 2)]
        for plots in (world.plots_x, world.plots_y)
    )
    return [[column * world.plots_y + row for column in wide for row in deep] for wide in columns for deep in rows]


def plots_along(blocks: list[list[int]], centres: Array, world: WorldConfig) -> list[int]:
    """Return the blocks' plots in the order of a closed tour that enters and leaves each block by a short path."""
    middle = np.array([centres[block].mean(axis=0) for block in blocks])
    order: list[int] = []
    before = middle[-1]
    for number, block in enumerate(blocks):
        after = middle[(number + 1) % len(blocks)]
        ways = list(permutations(block))
        lengths = [_length(centres[list(way)], before, after, world) for way in ways]
        order += ways[int(np.argmin(lengths))]
        before = centres[order[-1]]
    return order


def _length(places: Array, before: Array, after: Array, world: WorldConfig) -> float:
    outer = steps_between(before[None], places[:1], world) + steps_between(places[-1:], after[None], world)
    inner = np.abs(np.diff(places, axis=0)).sum()
    return float(outer[0, 0] + STRAIGHT * inner)
