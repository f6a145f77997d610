"""Observations of each type of UAV, scaled to about [-1, 1] (W24).

A position is 2 x / X - 1 and an offset is dx / X, dy / Y. A distance is three-dimensional and divided by the field's
diagonal. VDF and AoI are divided by their maxima. A UAV that does not exist is (0, 0, 1). One that is gone observes
zeros and is no part of what others observe. The agent's index within its type and the elapsed fraction of the episode
come last.

A mirrored view flips the axes so that one position, measured from the middle, is never below 0. For a relay or a
collector it is the position in the field; for a monitor it is the position in its plot. Everything along an axis is
multiplied by the axis's sign, and the VDF window is flipped. The signs of both axes come right after the agent's
position. The farm still takes actions along the field's axes; `MirroredAxes.adapt` flips the actors' commands.
"""

import math
from typing import Final

from eia_sec.common.config.farm import ObservationConfig
from eia_sec.common.farm_observation import SENSOR_SCALE
from eia_sec.rollout.sim.conditions.failures import see_nothing
from eia_sec.rollout.sim.core.arrays import Farm, Scratch
from eia_sec.rollout.sim.core.axes import in_field, in_plot, sign_of
from eia_sec.rollout.sim.core.compile import allocation_free, inlined
from eia_sec.rollout.sim.core.constants import Constants, FleetConstants
from eia_sec.rollout.sim.core.neighbours import ALL, EMPTY, HOLDING, nearest_sensors
from eia_sec.rollout.sim.core.planes import height_of
from eia_sec.rollout.sim.core.records import Array, Float32
from eia_sec.rollout.sim.observation.added import add_collector, add_monitor, add_relay

PER_SCALE: Final = 1.0 / SENSOR_SCALE


@allocation_free
def _put_place(what: ObservationConfig, x: float, y: float, sx: float, sy: float, seen: Float32, at: int) -> int:
    seen[at], seen[at + 1] = sx * x, sy * y
    at += 2
    if what.mirrored:
        seen[at], seen[at + 1] = sx, sy
        at += 2
    return at


@allocation_free
def _put_offset(
    fleet: FleetConstants, dx: float, dy: float, dz: float, sx: float, sy: float, seen: Float32, at: int
) -> int:
    seen[at], seen[at + 1] = sx * dx * fleet.per_width, sy * dy * fleet.per_depth
    seen[at + 2] = math.sqrt(dx * dx + dy * dy + dz * dz) * fleet.per_diagonal
    return at + 3


@allocation_free
def _put_uav(
    fleet: FleetConstants, position: Array, u: int, other: int, sx: float, sy: float, seen: Float32, at: int
) -> int:
    if other < 0:
        seen[at], seen[at + 1], seen[at + 2] = 0.0, 0.0, 1.0
        return at + 3
    dx, dy = position[other, 0] - position[u, 0], position[other, 1] - position[u, 1]
    return _put_offset(fleet, dx, dy, height_of(fleet, other) - height_of(fleet, u), sx, sy, seen, at)


@allocation_free
def _put_self(what: ObservationConfig, time: float, rank: int, count: int, seen: Float32, at: int) -> int:
    if what.identity:
        for other in range(count):
            seen[at + other] = 1.0 if other == rank else 0.0
        at += count
    if what.clock:
        seen[at] = time
        at += 1
    return at


@allocation_free
def _put_sensor(printed: bool, level: float, dx: float, dy: float, seen: Float32, at: int) -> int:
    seen[at] = level
    if printed:
        return at + 1
    seen[at + 1] = min(1.0, max(-1.0, dx * PER_SCALE))
    seen[at + 2] = min(1.0, max(-1.0, dy * PER_SCALE))
    return at + 3


@inlined
def see_relays(c: Constants, farm: Farm, s: Scratch, time: float, at: int) -> int:
    """Write o_c of all relays: own place; nearest relay, all relays' and served centroid, farthest served, nearest UAV.

    A relay that serves no UAV observes zeros for the centroid and the farthest UAV.

    Args:
        c: constants.
        farm: the environment; the function writes to its row of observations.
        s: scratch.
        time: elapsed fraction of the episode.
        at: where to begin in the row.

    Returns:
        where the next type begins in the row.
    """
    fleet, what, position, seen = c.fleet, c.seen, farm.position, farm.observation
    peer, neighbour, centroid, farthest = s.peer, s.neighbour, s.centroid, s.farthest
    for u in range(fleet.relays):
        if farm.gone[u]:
            at = see_nothing(c.fleet.sizes[0], seen, at)
            continue
        x, y = in_field(fleet, position, u)
        sx, sy = sign_of(what, x), sign_of(what, y)
        at = _put_place(what, x, y, sx, sy, seen, at)
        at = _put_uav(fleet, position, u, peer[u], sx, sy, seen, at)
        for point in (fleet.relays, u):
            dx, dy = centroid[point, 0] - position[u, 0], centroid[point, 1] - position[u, 1]
            dz = centroid[point, 2] - height_of(fleet, u)
            if point == u and farthest[u] < 0:
                dx, dy, dz = 0.0, 0.0, 0.0
            at = _put_offset(fleet, dx, dy, dz, sx, sy, seen, at)
        if farthest[u] < 0:
            at = _put_offset(fleet, 0.0, 0.0, 0.0, sx, sy, seen, at)
        else:
            at = _put_uav(fleet, position, u, farthest[u], sx, sy, seen, at)
        at = _put_uav(fleet, position, u, neighbour[u], sx, sy, seen, at)
        if c.added.some:
            at = add_relay(c, farm, s, u, at)
        at = _put_self(what, time, u, fleet.relays, seen, at)
    return at


@inlined
def see_plots(c: Constants, farm: Farm, s: Scratch, time: float, at: int) -> int:
    """Write o_m of all monitoring UAVs: own place, VDF of the plots around, D_VDF, nearest UAV.

    Plots outside the field have VDF 0, because they are worth as little as a plot just photographed. Arguments and
    result are those of `see_relays`.
    """
    fleet, what, camera, position, seen = c.fleet, c.seen, c.camera, farm.position, farm.observation
    neighbour, direction, level = s.neighbour, farm.direction, farm.level
    columns, rows = level.shape
    reach, count = what.window // 2, fleet.collectors - fleet.relays
    for u in range(fleet.relays, fleet.collectors):
        if farm.gone[u]:
            at = see_nothing(c.fleet.sizes[1], seen, at)
            continue
        column, row, across, along = in_plot(camera, position, u)
        sx, sy = sign_of(what, across), sign_of(what, along)
        x, y = in_field(fleet, position, u)
        at = _put_place(what, x, y, sx, sy, seen, at)
        for step_x in range(-reach, reach + 1):
            for step_y in range(-reach, reach + 1):
                i, j = column + int(sx) * step_x, row + int(sy) * step_y
                inside = 0 <= i < columns and 0 <= j < rows
                seen[at] = level[i, j] / camera.level_max if inside else 0.0
                at += 1
        seen[at], seen[at + 1] = sx * direction[u, 0], sy * direction[u, 1]
        at = _put_uav(fleet, position, u, neighbour[u], sx, sy, seen, at + 2)
        if what.lattice:
            seen[at], seen[at + 1] = sx * across, sy * along
            at += 2
        if c.added.some:
            at = add_monitor(c, farm, s, u, column, row, at)
        at = _put_self(what, time, u - fleet.relays, count, seen, at)
    return at


@inlined
def see_sensors(c: Constants, farm: Farm, s: Scratch, time: float, at: int) -> None:
    """Write o_d of all data collection UAVs: own place, n nearest sensors, D_AoI, nearest UAV.

    Updates `listed`, the sensors that each UAV observes. The previous step's sensors bound the search. Arguments are
    those of `see_relays`.
    """
    fleet, what, position, neighbour, direction = c.fleet, c.seen, farm.position, s.neighbour, farm.direction
    sensor, cell_start, age, waiting, seen = farm.sensor, farm.cell_start, farm.age, farm.waiting, farm.observation
    around, square, nearest, nearest_square = s.around, s.square, farm.listed, s.nearest_square
    holding, wanted, per_level = waiting[0], what.sensors, 1.0 / c.radio.level_max
    count = fleet.uavs - fleet.collectors
    for u in range(fleet.collectors, fleet.uavs):
        if farm.gone[u]:
            at = see_nothing(c.fleet.sizes[2], seen, at)
            continue
        x, y, listed = position[u, 0], position[u, 1], nearest[u - fleet.collectors]
        across, along = in_field(fleet, position, u)
        sx, sy = sign_of(what, across), sign_of(what, along)
        at = _put_place(what, across, along, sx, sy, seen, at)
        sort, total = (HOLDING, holding) if c.observation.waiting else (ALL, len(age))
        found = nearest_sensors(
            fleet, c.observation, x, y, sort, sensor, cell_start, age, total, around, square, listed, nearest_square
        )
        if found < wanted:
            rest, total, squares = listed[found:], len(age) - holding, nearest_square[found:]
            nearest_sensors(
                fleet, c.observation, x, y, EMPTY, sensor, cell_start, age, total, around, square, rest, squares
            )
        for rank in range(wanted):
            j = listed[rank]
            at = _put_sensor(
                c.observation.printed, age[j] * per_level, sx * (sensor[0, j] - x), sy * (sensor[1, j] - y), seen, at
            )
        seen[at], seen[at + 1] = sx * direction[u, 0], sy * direction[u, 1]
        at = _put_uav(fleet, position, u, neighbour[u], sx, sy, seen, at + 2)
        if c.added.some:
            at = add_collector(c, farm, s, u, at)
        at = _put_self(what, time, u - fleet.collectors, count, seen, at)
