"""The working memory of the added observations."""

from typing import Annotated, Final, NamedTuple

import numpy as np

from eia_sec.common.config import FarmConfig, WorldConfig
from eia_sec.common.farm_observation import HOLD
from eia_sec.rollout.sim.core.cells import cell_counts
from eia_sec.rollout.sim.core.records import Array, Flags, Float32, Indices, Int32, make_record

LANES: Final = 8
"""Rows of numbers are filled up to a multiple of this, so that vectorised loops have no rest."""
TWO_MOVES: Final = 25
"""Lattice points two moves away."""


class FieldScratch(NamedTuple):
    """A value field over rows of points; rows are filled up to so many points.

    Float32 halves the time, and its rounding is far below what a UAV could use.
    """

    x: Annotated[Float32, "points", "of each point, m"]
    y: Annotated[Float32, "points", "of each point, m"]
    value: Annotated[Float32, "points", "level of each point over the largest"]
    stale: Annotated[Float32, "points", "the same times itself, or times 1 if that is less"]
    first: Annotated[Float32, "points", "square of the distance to the nearest UAV of the type, m^2"]
    second: Annotated[Float32, "points", "square of the distance to the second nearest, m^2"]
    weight: Annotated[Float32, "2 points", "a UAV's own share of value and stale"]
    across: Annotated[
        Float32,
        "2 4 filled",
        "exponentials of the distances along x from three places after a move and the UAV's own, near range first",
    ]
    along: Annotated[Float32, "2 4 rows", "the same along y"]
    sums: Annotated[Float32, "4 filled", "sums over the rows for the four places along y"]
    total: Annotated[Array, "2 16", "the field at the nine places and at the UAV's, near range first"]


class ViewScratch(NamedTuple):
    """Working memory of the added observations. `twice` holds 15 lattice points in three columns, filled up to 16."""

    velocity: Annotated[Array, "n 2", "last velocity as a share of full speed"]
    sign: Annotated[Array, "n 2", "signs of the UAVs' axes"]
    go_x: Annotated[Array, "n 3", "x after a move back, none and on along the UAV's own axis, m"]
    go_y: Annotated[Array, "n 3", "the same along y, m"]
    path_x: Annotated[Array, "n ahead 3", "x after each step of these moves, where they are held; see `inertia`"]
    path_y: Annotated[Array, "n ahead 3", "the same along y, m"]
    stop_x: Annotated[Array, "n 3", "x where a UAV could stop after a step of them, m"]
    stop_y: Annotated[Array, "n 3", "the same along y, m"]
    stopped: Annotated[Flags, "9", "whether a zone would refuse each move"]
    ends: Annotated[Int32, "9", "lattice points in whose cells the moves end, where zones are"]
    away: Annotated[
        Array,
        "9",
        "steps of the way round zones from each move's end to the next box of the route; 0 without zones",
    ]
    near: Annotated[Indices, "64", "UAVs of the own type, nearest first"]
    near_square: Annotated[Array, "64", "squares of their distances, m^2"]
    risk: Annotated[
        Array,
        "3 16",
        "metres of risk of each move, for a peer that does anything and for one that flies on, and the last distance",
    ]
    place_x: Annotated[Array, "places", "x of the places of a plan, m"]
    place_y: Annotated[Array, "places", "the same along y, m"]
    square: Annotated[Array, "places", "squares of their distances to an item, m^2"]
    far: Annotated[Array, "2 5", "middles of the lattice points two moves back to two on, along each axis, m"]
    after: Annotated[Indices, "2 9", "which of five lattice points along an axis a move leads to after another"]
    chance: Annotated[Array, "places", "share of an item that each place brings"]
    gain: Annotated[Array, "places", "units that each place brings"]
    twice: Annotated[
        Array,
        "9 16",
        "units that both moves would bring, and only one does, from the first lattice point that may follow "
        "the first move; see `units._first_after`",
    ]
    plots: FieldScratch
    cells: FieldScratch


def make_view_scratch(config: FarmConfig) -> ViewScratch:
    """Allocate the working memory of the added observations."""
    world, two = config.world, config.observation.units > 1
    ahead = config.dynamics.inertial * 2 * HOLD
    places = _filled(9 * HOLD * (1 + two) if ahead else 9 + TWO_MOVES * two)
    plots, cells = _field(world, world.plots_x, world.plots_y), _field(world, *cell_counts(world))
    return make_record(ViewScratch, {"n": world.uavs, "places": places, "ahead": ahead}, plots=plots, cells=cells)


def _filled(count: int) -> int:
    """Return the next multiple of LANES."""
    return -(-count // LANES) * LANES


def _field(world: WorldConfig, columns: int, rows: int) -> FieldScratch:
    filled = _filled(columns)
    field = make_record(FieldScratch, {"points": rows * filled, "filled": filled, "rows": rows})
    field.x[:] = np.tile((np.arange(filled) + 0.5) * (world.field_x / columns), rows)
    field.y[:] = np.repeat((np.arange(rows) + 0.5) * (world.field_y / rows), filled)
    return field
