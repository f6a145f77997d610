"""Where UAVs with inertia get to: the places of nine velocities that are held, where they can stop, and what they see.

With inertia a move is a velocity that is commanded and held: back, none or on along each of the UAV's own axes, at top
speed. The places of nine moves are those after HOLD steps. Which plots and sensors it would pass is read off all the
steps up to there, and for `units` 2 off twice as many. Wind is left out of all this.
"""

from typing import Final

from eia_sec.common.farm_observation import HOLD
from eia_sec.rollout.sim.conditions.zones import refused
from eia_sec.rollout.sim.core.compile import allocation_free
from eia_sec.rollout.sim.core.constants import FleetConstants
from eia_sec.rollout.sim.core.dynamics import (
    ACCELERATION,
    COMMAND,
    VELOCITY,
    DynamicsConstants,
    glide,
    stopping_way,
)
from eia_sec.rollout.sim.core.records import Array, Float32

ROUNDING: Final = 1e-6
"""How far outside a UAV may stop that stands at the border but for rounding, m."""


@allocation_free
def hold_moves(
    d: DynamicsConstants,
    kind: int,
    motion: Array,
    axis: int,
    sign: float,
    top: float,
    place: float,
    side: float,
    seconds: float,
    path: Array,
    go: Array,
    stop: Array,
) -> None:
    """Find where a velocity back, none and on along an axis leads that is held.

    Args:
        d: limits.
        kind: the UAV's type.
        motion: [6] of the UAV.
        axis: 0 for x, 1 for y.
        sign: of the UAV's own axis.
        top: top speed along the axis, m/s.
        place: along the axis, m.
        side: of the field, m.
        seconds: of a step.
        path: [steps, 3] out: places after each step, in the field, m.
        go: [3] out: those after HOLD steps.
        stop: [3] out: where the UAV stops if it is told so after the first step, in the field or not, m.
    """
    most, jerk, delay = d.acceleration[kind], d.jerk[kind], d.delay[kind]
    start, v0, a0 = glide(
        motion[VELOCITY + axis], motion[ACCELERATION + axis], motion[COMMAND + axis], most, jerk, delay
    )
    for move in range(3):
        command = sign * (move - 1.0) * top
        way, v, a = glide(v0, a0, command, most, jerk, seconds - delay)
        at = place + start + way
        stop[move] = at + stopping_way(d, kind, v, a, command)
        path[0, move] = min(side, max(0.0, at))
        for step in range(1, len(path)):
            way, v, a = glide(v, a, command, most, jerk, seconds)
            at += way
            path[step, move] = min(side, max(0.0, at))
        go[move] = path[HOLD - 1, move]


@allocation_free
def put_motion(
    fleet: FleetConstants,
    d: DynamicsConstants,
    kind: int,
    scale: float,
    motion: Array,
    x: float,
    y: float,
    sx: float,
    sy: float,
    stop_x: Array,
    stop_y: Array,
    zone_side: Array,
    zone_box: Array,
    seen: Float32,
    at: int,
) -> int:
    """Write a UAV's acceleration, its last command, the way to where it can stop, and which moves overrun.

    A move overruns if the UAV that makes it for a step cannot stop inside the field and before a zone any more.
    """
    seen[at] = sx * motion[ACCELERATION] / d.acceleration[kind]
    seen[at + 1] = sy * motion[ACCELERATION + 1] / d.acceleration[kind]
    seen[at + 2] = sx * motion[COMMAND] / fleet.speed_x
    seen[at + 3] = sy * motion[COMMAND + 1] / fleet.speed_y
    for axis in range(2):
        way = stopping_way(d, kind, motion[VELOCITY + axis], motion[ACCELERATION + axis], motion[COMMAND + axis])
        seen[at + 4 + axis] = (sx if axis == 0 else sy) * way / scale
    at += 6
    for move in range(9):
        to_x, to_y = stop_x[move // 3], stop_y[move % 3]
        over = to_x < -ROUNDING or to_x > fleet.width + ROUNDING or to_y < -ROUNDING or to_y > fleet.depth + ROUNDING
        if fleet.zones and not over:
            over = refused(fleet.zone_first, zone_side, zone_box, x, y, to_x, to_y)
        seen[at + move] = 1.0 if over else 0.0
    return at + 9
