"""Where the nine moves of a UAV lead, and the velocities and axes that the added observations need.

A relay's move is at full speed along each axis, and ends at the field's border. That of any other UAV leads to a
neighbouring lattice point, or only so far into its cell as the inset says, as far as a step at full speed goes. This is
`Lattice.adapt` and the flight after it, so that the place is the very one. With inertia `inertia` says where they lead.
"""

import numpy as np

from eia_sec.rollout.sim.core.arrays import Farm, Scratch
from eia_sec.rollout.sim.core.axes import along_side, in_field, in_plot, sign_of
from eia_sec.rollout.sim.core.compile import allocation_free, inlined
from eia_sec.rollout.sim.core.constants import Constants
from eia_sec.rollout.sim.core.dynamics import VELOCITY
from eia_sec.rollout.sim.core.lattice import cell_at, cell_beside, share_of, velocity_to
from eia_sec.rollout.sim.core.planes import kind_of
from eia_sec.rollout.sim.core.records import Array, Indices
from eia_sec.rollout.sim.observation.inertia import hold_moves


@allocation_free
def _share(x: float, sign: float, side: float, per_side: float) -> np.float32:
    """Return where a UAV stands along its own axis as a share of the field."""
    return share_of(np.float32(sign * along_side(x, side, per_side)))


@allocation_free
def own_point(x: float, sign: float, side: float, per_side: float, count: int) -> int:
    """Return the lattice point of a UAV along an axis of the field, chosen along its own axis."""
    point = int(cell_at(_share(x, sign, side, per_side), np.float32(count)))
    return point if sign > 0.0 else count - 1 - point


@allocation_free
def _go(
    x: float,
    sign: float,
    side: float,
    per_side: float,
    count: int,
    reach: float,
    inset: float,
    speed: float,
    seconds: float,
    places: Array,
) -> None:
    """Write where a move back, none and on leads along an axis, [3] m."""
    share, points = _share(x, sign, side, per_side), np.float32(count)
    point = cell_at(share, points)
    for move in range(3):
        cell = cell_beside(point, np.float32(move - 1), points)
        velocity = velocity_to(cell, share, points, np.float32(reach), np.float32(inset))
        places[move] = min(side, max(0.0, x + sign * np.float64(velocity) * speed * seconds))


@inlined
def find_places(c: Constants, farm: Farm, s: Scratch) -> None:
    """Find the velocities and the axes of all UAVs, and where their moves lead."""
    fleet, camera, view, what, position = c.fleet, c.camera, c.added, c.seen, farm.position
    previous, velocity, sign, go_x, go_y = s.previous, s.added.velocity, s.added.sign, s.added.go_x, s.added.go_y
    for u in range(fleet.uavs):
        if farm.gone[u]:
            continue
        x, y = position[u, 0], position[u, 1]
        velocity[u, 0], velocity[u, 1] = (x - previous[u, 0]) / view.step_x, (y - previous[u, 1]) / view.step_y
        if c.dynamics.some:
            velocity[u, 0] = farm.motion[u, VELOCITY] / fleet.speed_x
            velocity[u, 1] = farm.motion[u, VELOCITY + 1] / fleet.speed_y
        across, along = in_field(fleet, position, u)
        if fleet.relays <= u < fleet.collectors:
            _, _, across, along = in_plot(camera, position, u)
        sx, sy = sign_of(what, across), sign_of(what, along)
        sign[u, 0], sign[u, 1] = sx, sy
        if c.dynamics.some:
            d, v, kind = c.dynamics, s.added, kind_of(fleet, u)
            hold_moves(
                d,
                kind,
                farm.motion[u],
                0,
                sx,
                min(fleet.speed_x, d.speed[kind]),
                x,
                fleet.width,
                fleet.seconds,
                v.path_x[u],
                go_x[u],
                v.stop_x[u],
            )
            hold_moves(
                d,
                kind,
                farm.motion[u],
                1,
                sy,
                min(fleet.speed_y, d.speed[kind]),
                y,
                fleet.depth,
                fleet.seconds,
                v.path_y[u],
                go_y[u],
                v.stop_y[u],
            )
        elif u < fleet.relays:
            for move in range(3):
                go_x[u, move] = min(fleet.width, max(0.0, x + sx * (move - 1) * view.step_x))
                go_y[u, move] = min(fleet.depth, max(0.0, y + sy * (move - 1) * view.step_y))
        else:
            inset = view.monitoring_inset if u < fleet.collectors else view.collection_inset
            _go(
                x,
                sx,
                fleet.width,
                fleet.per_width,
                view.columns,
                view.reach_x,
                inset,
                fleet.speed_x,
                fleet.seconds,
                go_x[u],
            )
            _go(
                y,
                sy,
                fleet.depth,
                fleet.per_depth,
                view.rows,
                view.reach_y,
                inset,
                fleet.speed_y,
                fleet.seconds,
                go_y[u],
            )


@allocation_free
def go_twice(x: float, sign: float, side: float, per_side: float, count: int, far: Array, after: Indices) -> None:
    """Find where two moves lead along an axis: to one of five lattice points, whatever the inset is.

    Where steps end at cells' centres, the second move reaches that point, wherever the first one ended.

    Args:
        x: place along the axis, m.
        sign: of the UAV's own axis.
        side: of the field, m.
        per_side: 1 / side, 1/m.
        count: lattice points.
        far: [5] out: middles of the lattice points two back to two on, those in the field, m.
        after: [9] out: which of the five each second move leads to after each first one.
    """
    last, point = count - 1, int(cell_at(_share(x, sign, side, per_side), np.float32(count)))
    for k in range(5):
        middle = (min(last, max(0, point + k - 2)) + 0.5) * side / count
        far[k] = middle if sign > 0.0 else side - middle
    for move in range(9):
        once = min(last, max(0, point + move // 3 - 1))
        after[move] = min(last, max(0, once + move % 3 - 1)) - point + 2
