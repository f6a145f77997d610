"""Stops grouped by k-means, one group for each UAV, and a short closed tour through the stops of each group.

Source: k-means and a tour per cluster, as for data ferries; 2-opt of Croes (1958), see Lin (1965).
"""

import functools
from itertools import permutations
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.cluster.vq import kmeans2

from common.config import WorldConfig
from common.seeds import stream
from rollout.heuristics.composite import COLLECTORS, MONITORS, FarmState, GroupPolicy
from rollout.heuristics.sites import plot_boxes, plot_centres, sensor_stops, steps_between
from rollout.heuristics.steering import Array
from rollout.heuristics.tour_follower import TourFollower

Indices = NDArray[np.int64]

RESTARTS: Final = 5
"""Groupings that are tried on each farm; the one whose longest tour is shortest is kept."""
PLOT_RESTARTS: Final = 20
"""The same for plots, which are grouped once for all farms."""
STARTS: Final = 30
"""About how many places a tour is started from, at most."""
EASY: Final = 128
"""Up to so many places of a tour all starts and groupings are tried; of more, fewer: their time grows by the cube."""
SAVING: Final = 1e-9
"""Least saving for which a tour is changed, steps."""
STRAIGHT: Final = 0.001
"""Weight of the way along both axes inside a block of plots, 1/m: among equal ends, few diagonals are flown."""


def monitors(state: FarmState) -> GroupPolicy:
    """Return monitors whose stops are blocks of two by two plots; one plot is imaged per step."""
    boxes = plot_boxes(state.config)
    return TourFollower([boxes[:, list(plots)] for plots in plot_tours(state.config.world)], MONITORS, state)


def collectors(state: FarmState) -> GroupPolicy:
    """Return collectors whose stops are places from which sensors are heard well."""
    world = state.config.world
    boxes = sensor_stops(state.config, state.layout.sensor_xy)
    random = stream("tour", "sensors", *state.seeds)
    tours = grouped_tours(boxes.mean(axis=0), world.collection_uavs, world, random, RESTARTS)
    return TourFollower([boxes[:, tour] for tour in tours], COLLECTORS, state)


@functools.lru_cache(maxsize=8)
def plot_tours(world: WorldConfig) -> tuple[tuple[int, ...], ...]:
    """Return for each monitor the plots of its tour, in row-major numbers; the same on every farm."""
    blocks, centres = plot_blocks(world), plot_centres(world)
    stops = np.array([centres[block].mean(axis=0) for block in blocks])
    tours = grouped_tours(stops, world.monitoring_uavs, world, stream("tour", "plots"), PLOT_RESTARTS)
    return tuple(tuple(plots_along([blocks[stop] for stop in tour], centres, world)) for tour in tours)


def grouped_tours(
    stops: Array, uavs: int, world: WorldConfig, random: np.random.Generator, restarts: int
) -> list[Indices]:
    """Return a closed tour through some of the stops [L, 2] for each UAV; with fewer stops than UAVs some share one."""
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
    """Return a short closed tour through places [L, 2] and its steps: from some starts the nearest next, then 2-opt."""
    steps = steps_between(places, places, world)
    best, least = np.arange(len(places)), np.inf
    for start in range(0, len(places), 1 + len(places) // tries(STARTS, len(places))):
        tour = two_opt(nearest_next(steps, start), steps)
        length = float(steps[tour, np.roll(tour, -1)].sum())
        if length < least - SAVING:
            best, least = tour, length
    return best, least


def tries(most: int, places: int) -> int:
    """Return how many of at most so many tries a tour through so many places is given."""
    return max(1, min(most, int(STARTS * (EASY / max(1, places)) ** 3)))


def nearest_next(steps: Array, start: int) -> Indices:
    """Return the tour that always goes on to the nearest place that is left, by steps [L, L]."""
    left, tour = steps.copy(), np.empty(len(steps), np.int64)
    at = start
    for index in range(len(steps)):
        tour[index] = at
        left[:, at] = np.inf
        at = int(left[at].argmin())
    return tour


def two_opt(tour: Indices, steps: Array) -> Indices:
    """Return a closed tour after the best exchanges of two of its edges, until none saves anything."""
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
    """Return the plots, in row-major numbers, of every block of two by two; at an odd border of fewer."""
    columns, rows = (
        [range(first, min(first + 2, plots)) for first in range(0, plots, 2)]
        for plots in (world.plots_x, world.plots_y)
    )
    return [[column * world.plots_y + row for column in wide for row in deep] for wide in columns for deep in rows]


def plots_along(blocks: list[list[int]], centres: Array, world: WorldConfig) -> list[int]:
    """Return the plots of blocks in the order of a closed tour: each block is entered and left on the short way."""
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
