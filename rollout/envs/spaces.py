"""The observation and action spaces that every interface to the farm shares.

The bounds follow from `rollout/sim/kernel/observation.py` and hold in every state; no value is clipped to meet
them. UAVs never leave the field, so an offset is at most 1. A distance is three-dimensional but divided by the field's
two-dimensional diagonal, so it may exceed 1 where two UAVs fly at different heights.
"""

import math
from typing import Final

import numpy as np
from gymnasium.spaces import Box

from eia_sec.common.config import FarmConfig, WorldConfig
from eia_sec.common.farm import COLLECTION, COMMUNICATION, MONITORING, farm_team
from eia_sec.common.team import Float32
from eia_sec.rollout.envs.added_parts import Part, added_parts
from eia_sec.rollout.sim.kernel.observation import SENSOR_SCALE

DIAGONAL: Final = math.sqrt(0.5)
"""Largest component of D_VDF and D_AoI, which are unit diagonals or 0."""
__all__ = ["Part", "action_box", "observation_bounds", "observation_box", "observation_parts", "row_box"]

ROUNDING: Final = 1.0 + 1e-12
"""Allowance for the order of float64 operations in a distance before it is rounded to float32."""


def observation_parts(config: FarmConfig) -> dict[str, tuple[Part, ...]]:
    """Return the parts of one observation in order, by type of agent."""
    world = config.world
    served = _apart(world, world.height_communication, (world.height_monitoring, world.height_collection))
    window = config.observation.window
    around = f"{window} x {window} plots"
    return {
        COMMUNICATION: (
            *_place(config),
            *_towards("nearest relay", 1.0),
            *_towards("centroid of all relays", 1.0),
            *_towards("centroid of those served", served),
            *_towards("farthest served", served),
            *_nearest(config, world.height_communication),
            *added_parts(config, COMMUNICATION, served),
            *_self(config, world.communication_uavs),
        ),
        MONITORING: (
            *_place(config),
            Part("VDF", window**2, 0.0, 1.0, f"VDF over its largest value of the {around} around, x outer; 0 outside"),
            Part("D_VDF", 2, -DIAGONAL, DIAGONAL, "unit diagonal to the quadrant with most VDF; 0 if there is none"),
            *_nearest(config, world.height_monitoring),
            *_lattice(config),
            *added_parts(config, MONITORING, served),
            *_self(config, world.monitoring_uavs),
        ),
        COLLECTION: (
            *_place(config),
            *_sensors(config),
            Part("D_AoI", 2, -DIAGONAL, DIAGONAL, "unit diagonal to the quadrant with most AoI; 0 if there is none"),
            *_nearest(config, world.height_collection),
            *added_parts(config, COLLECTION, served),
            *_self(config, world.collection_uavs),
        ),
    }


def observation_bounds(config: FarmConfig) -> dict[str, tuple[Float32, Float32]]:
    """Return the lower and upper bounds of an observation, [o_v] float32 each, by type of agent."""
    bounds = {}
    for name, parts in observation_parts(config).items():
        sizes = [part.size for part in parts]
        low = np.repeat([part.low for part in parts], sizes).astype(np.float32)
        high = np.repeat([part.high for part in parts], sizes).astype(np.float32)
        bounds[name] = (low, high)
    return bounds


def observation_box(config: FarmConfig, name: str, leading: tuple[int, ...] = ()) -> Box:
    """Return the observation space of a type, [*leading, o_v]."""
    low, high = (np.broadcast_to(bound, (*leading, len(bound))) for bound in observation_bounds(config)[name])
    return Box(low, high, dtype=np.float32)


def row_box(config: FarmConfig) -> Box:
    """Return the space of one row of observations, [O]."""
    bounds, counts = observation_bounds(config), [group.count for group in farm_team(config).groups]
    low, high = (
        np.concatenate([np.tile(both[side], count) for both, count in zip(bounds.values(), counts, strict=True)])
        for side in (0, 1)
    )
    return Box(low, high, dtype=np.float32)


def action_box(*shape: int) -> Box:
    """Return the action space of a shape: velocities along the field's axes as fractions of the top speed."""
    return Box(-1.0, 1.0, shape, np.float32)


def _place(config: FarmConfig) -> tuple[Part, ...]:
    place = Part("place", 2, -1.0, 1.0, "own (x, y), 2 x / X - 1")
    if not config.observation.mirrored:
        return (place,)
    return place, Part(
        "signs", 2, -1.0, 1.0, "of the agent's axes, 1 or -1; they scale values along the axes and flip the VDF window"
    )


def _towards(name: str, farthest: float) -> tuple[Part, ...]:
    return (
        Part(name, 2, -1.0, 1.0, "offset (dx / X, dy / Y)"),
        Part(name, 1, 0.0, farthest, "distance over the field's diagonal"),
    )


def _nearest(config: FarmConfig, height: float) -> tuple[Part, ...]:
    """Return the view of the nearest UAV. It flies in the same plane unless all planes are searched (W10)."""
    world = config.world
    heights = (world.height_communication, world.height_monitoring, world.height_collection)
    others = heights if config.reward.nearest == "any" else (height,)
    return _towards("nearest UAV", _apart(world, height, others))


def _lattice(config: FarmConfig) -> tuple[Part, ...]:
    if not config.observation.lattice:
        return ()
    return (Part("place in the plot", 2, -1.0, 1.0, "offset to the middle of the own plot over half a plot"),)


def _self(config: FarmConfig, count: int) -> tuple[Part, ...]:
    """Return the parts for an agent's index within its type and for the clock, if it observes them."""
    seen = config.observation
    rank = (Part("rank", count, 0.0, 1.0, "one-hot index of the agent within its type"),) if seen.identity else ()
    clock = (Part("clock", 1, 0.0, 1.0, "fraction of the episode that has passed"),) if seen.clock else ()
    return rank + clock


def _apart(world: WorldConfig, height: float, others: tuple[float, ...]) -> float:
    """Return the largest distance to a UAV at any of the other heights, divided by the field's diagonal."""
    rise = max(abs(other - height) for other in others)
    diagonal = math.hypot(world.field_x, world.field_y)
    return math.hypot(diagonal, rise) / diagonal * (ROUNDING if rise else 1.0)


def _sensors(config: FarmConfig) -> tuple[Part, ...]:
    count, meaning = config.observation.sensors, "AoI over its largest value"
    if config.observation.form == "printed":
        return (Part("sensors", count, 0.0, 1.0, meaning),)
    one = (
        Part("sensor", 1, 0.0, 1.0, meaning),
        Part("sensor", 2, -1.0, 1.0, f"offset (dx, dy) over {SENSOR_SCALE:g} m, clipped"),
    )
    return one * count
