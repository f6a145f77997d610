"""The working memory of the added observations, allocated once."""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig, WorldConfig
from eia_sec.rollout.sim.layout import cell_counts

Array = NDArray[np.float64]
Float32 = NDArray[np.float32]
Indices = NDArray[np.int64]
Int32 = NDArray[np.int32]
Flags = NDArray[np.bool_]

LANES: Final = 8
"""Rows of numbers are filled up to a multiple of this, so that vectorised loops have no rest."""
TWO_MOVES: Final = 25
"""Lattice points two moves away."""
FOLLOWING: Final = 15
"""Lattice points, in three columns, among which are all that may follow a move."""


class FieldScratch(NamedTuple):
    """A value field over R rows and C columns of points, row by row; rows are filled up to C' points.

    Float32 halves the time, and its rounding is far below what a UAV could use.

    Attributes:
        x: [R C'] of each point, m.
        y: [R C'] of each point, m.
        value: [R C'] level of each point over the largest.
        stale: [R C'] the same times itself, or times 1 if that is less.
        first: [R C'] square of the distance to the nearest UAV of the type, m^2.
        second: [R C'] square of the distance to the second nearest, m^2.
        weight: [2, R C'] a UAV's own share of value and stale.
        across: [2, 4, C'] exponentials of the distances along x from three places after a move and the UAV's own, near
            range first.
        along: [2, 4, R] the same along y.
        sums: [4, C'] sums over the rows for the four places along y.
        total: [2, 16] the field at the nine places and at the UAV's, near range first.
    """

    x: Float32
    y: Float32
    value: Float32
    stale: Float32
    first: Float32
    second: Float32
    weight: Float32
    across: Float32
    along: Float32
    sums: Float32
    total: Array


class ViewScratch(NamedTuple):
    """Working memory of the added observations.

    Attributes:
        velocity: [n, 2] last velocity as a share of full speed.
        sign: [n, 2] signs of the UAVs' axes.
        go_x: [n, 3] x after a move back, none and on along the UAV's own axis, m.
        go_y: [n, 3] the same along y, m.
        stopped: [9] whether a zone would refuse each move.
        ends: [9] lattice points in whose cells the moves end, where zones are.
        away: [9] steps of the way round zones from each move's end to the next box of the route; 0 without zones.
        near: [64] UAVs of the own type, nearest first.
        near_square: [64] squares of their distances, m^2.
        risk: [2, 16] metres of risk of each move, for a peer that does anything and for one that flies on.
        place_x: [K] x of the places of a plan, m.
        place_y: [K] the same along y, m.
        square: [K] squares of their distances to an item, m^2.
        far: [2, 5] middles of the lattice points two moves back to two on, along each axis, m.
        after: [2, 9] which of five lattice points along an axis a move leads to after another.
        chance: [K] share of an item that each place brings.
        gain: [K] units that each place brings.
        twice: [9, 16] units that both moves would bring, and only one does, from the first lattice point that may
            follow the first move; see `units._first_after`.
        plots: value field of the monitoring UAVs.
        cells: value field of the data collection UAVs.
    """

    velocity: Array
    sign: Array
    go_x: Array
    go_y: Array
    stopped: Flags
    ends: Int32
    away: Array
    near: Indices
    near_square: Array
    risk: Array
    place_x: Array
    place_y: Array
    square: Array
    far: Array
    after: Indices
    chance: Array
    gain: Array
    twice: Array
    plots: FieldScratch
    cells: FieldScratch


def make_view_scratch(config: FarmConfig) -> ViewScratch:
    """Allocate the working memory of the added observations."""
    world = config.world
    places = _filled(9 + TWO_MOVES * (config.observation.units > 1))
    return ViewScratch(
        velocity=np.zeros((world.uavs, 2)),
        sign=np.zeros((world.uavs, 2)),
        go_x=np.zeros((world.uavs, 3)),
        go_y=np.zeros((world.uavs, 3)),
        stopped=np.zeros(9, np.bool_),
        ends=np.zeros(9, np.int32),
        away=np.zeros(9),
        near=np.zeros(64, np.int64),
        near_square=np.zeros(64),
        risk=np.zeros((2, 16)),
        place_x=np.zeros(places),
        place_y=np.zeros(places),
        square=np.zeros(places),
        far=np.zeros((2, 5)),
        after=np.zeros((2, 9), np.int64),
        chance=np.zeros(places),
        gain=np.zeros(places),
        twice=np.zeros((9, _filled(FOLLOWING))),
        plots=_field(world, world.plots_x, world.plots_y),
        cells=_field(world, *cell_counts(world)),
    )


def _filled(count: int) -> int:
    """Return the next multiple of LANES."""
    return -(-count // LANES) * LANES


def _field(world: WorldConfig, columns: int, rows: int) -> FieldScratch:
    filled = _filled(columns)
    points = rows * filled
    x = np.tile((np.arange(filled) + 0.5) * (world.field_x / columns), rows)
    y = np.repeat((np.arange(rows) + 0.5) * (world.field_y / rows), filled)
    return FieldScratch(
        x=x.astype(np.float32),
        y=y.astype(np.float32),
        value=np.zeros(points, np.float32),
        stale=np.zeros(points, np.float32),
        first=np.zeros(points, np.float32),
        second=np.zeros(points, np.float32),
        weight=np.zeros((2, points), np.float32),
        across=np.zeros((2, 4, filled), np.float32),
        along=np.zeros((2, 4, rows), np.float32),
        sums=np.zeros((4, filled), np.float32),
        total=np.zeros((2, 16)),
    )
