"""Chains of relays to the base station at the field's edge.

A relay is joined while hops of at most the hop range, over living relays, lead from it to the base station. A hop's
length is three-dimensional: relays fly at their height, and the base station stands on the ground.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.config import FarmConfig
from eia_sec.rollout.sim.base_station import base_place
from eia_sec.rollout.sim.kernel.compiler.decorators import allocation_free

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]


class ChainConstants(NamedTuple):
    """The base station and the hops to it.

    Attributes:
        some: whether links count only over a chain to it.
        x: of the base station, m.
        y: of the base station, m.
        height: of the relays over it, m.
        hop_range: m.
    """

    some: bool
    x: float
    y: float
    height: float
    hop_range: float


def chain_constants(config: FarmConfig) -> ChainConstants:
    """Derive the numbers of the base station."""
    x, y = base_place(config).tolist()
    return ChainConstants(config.relay.chained, x, y, config.world.height_communication, config.relay.hop_range)


@allocation_free
def join_relays(
    chain: ChainConstants,
    position: Array,
    gone: Flags,
    moved: int,
    to_x: float,
    to_y: float,
    joined: Flags,
    queue: Indices,
) -> int:
    """Write which relays are joined, from the base station on outwards; return their number.

    Args:
        chain: constants.
        position: [n, 2] of all UAVs, m; relays come first.
        gone: [n] whether a UAV has failed.
        moved: a relay that stands elsewhere, or -1 for none.
        to_x: where it stands, m; infinite to leave it out.
        to_y: the same along y.
        joined: [n_c] whether each relay is joined.
        queue: [n_c] scratch.
    """
    count, done = 0, 0
    for i in range(len(joined)):
        x, y = (to_x, to_y) if i == moved else (position[i, 0], position[i, 1])
        joined[i] = not gone[i] and _within(chain, x - chain.x, y - chain.y, chain.height)
        if joined[i]:
            queue[count] = i
            count += 1
    while done < count:
        j = queue[done]
        from_x, from_y = (to_x, to_y) if j == moved else (position[j, 0], position[j, 1])
        done += 1
        for i in range(len(joined)):
            if not joined[i] and not gone[i]:
                x, y = (to_x, to_y) if i == moved else (position[i, 0], position[i, 1])
                if _within(chain, x - from_x, y - from_y, 0.0):
                    joined[i] = True
                    queue[count] = i
                    count += 1
    return count


@allocation_free
def _within(chain: ChainConstants, dx: float, dy: float, dz: float) -> bool:
    within: bool = math.sqrt(dx * dx + dy * dy + dz * dz) <= chain.hop_range
    return within
