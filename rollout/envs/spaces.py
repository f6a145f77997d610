"""The observation and action spaces that every interface to the farm shares."""

import numpy as np
from gymnasium.spaces import Box

from eia_sec.common.config import FarmConfig
from eia_sec.common.farm import farm_team
from eia_sec.common.farm_observation import TYPES, observation_parts
from eia_sec.common.team import Float32


def observation_bounds(config: FarmConfig) -> dict[str, tuple[Float32, Float32]]:
    """Return the lower and upper bounds of an observation, [o_v] float32 each, by type of agent."""
    bounds = {}
    for name in TYPES:
        parts = observation_parts(config, name)
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
