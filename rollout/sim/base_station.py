"""The base station at the field's edge, and the chains of relays that end at it."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.rollout.sim.boxes import Array

MIDDLES: Final = {"north": (0.5, 1.0), "east": (1.0, 0.5), "south": (0.5, 0.0), "west": (0.0, 0.5)}
"""Middles of the field's edges as shares of its sides; x goes east and y north."""


def base_place(config: FarmConfig) -> Array:
    """Return where the base station stands, [2] m; (0, 0) if there is none."""
    share = MIDDLES.get(config.relay.base, (0.0, 0.0))
    return np.array(share) * (config.world.field_x, config.world.field_y)


def relay_gaps(config: FarmConfig, places: Array) -> tuple[Array, Array]:
    """Return the distances between relays, [..., n_c, n_c] m, and from each to the base station, [..., n_c] m.

    Args:
        config: a farm with a base station.
        places: [..., n_c, 2] of the relays, m.
    """
    between = np.sqrt(((places[..., :, None, :] - places[..., None, :, :]) ** 2).sum(axis=-1))
    flat = ((places - base_place(config)) ** 2).sum(axis=-1)
    return between, np.sqrt(flat + config.world.height_communication**2)


def joined_relays(config: FarmConfig, places: Array, gone: NDArray[np.bool_] | None = None) -> NDArray[np.bool_]:
    """Return which relays hops within range lead from to the base station, [..., n_c].

    Args:
        config: the farm. Without a base station all living relays count as joined.
        places: [..., n_c, 2] of the relays, m.
        gone: [..., n_c] whether a relay has failed; nobody by default.
    """
    living = np.ones(places.shape[:-1], np.bool_) if gone is None else ~gone
    if not config.relay.chained:
        return living
    between, down = relay_gaps(config, places)
    near = between <= config.relay.hop_range
    joined = (down <= config.relay.hop_range) & living
    for _ in range(places.shape[-2] - 1):
        joined = joined | ((near & joined[..., None, :]).any(axis=-1) & living)
    return joined
