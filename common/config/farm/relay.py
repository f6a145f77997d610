"""The relays: their service quality, and whom each one serves.

A docstring that ends in "(ours)" marks a constant that the paper does not give; (W3) and the like one that our
reading of it settles; all others are from its Tables 1 and 2.
"""

import math
from dataclasses import dataclass
from typing import ClassVar, Literal

from eia_sec.common.config.checks import not_negative, positive
from eia_sec.common.config.farm.world import WorldConfig
from eia_sec.common.errors import ConfigError


@dataclass(frozen=True)
class RelayConfig:
    """Service quality D_c of the relays (communication UAVs), and the assignment of UAVs to them."""

    weight_centroid: ClassVar[float] = 0.5
    """Weight epsilon_1 of D_cg, the distance to the centroid of the served UAVs."""
    weight_farthest: ClassVar[float] = 0.2
    """Weight epsilon_2 of D_cf, the distance to the farthest served UAV."""
    weight_relays: ClassVar[float] = 0.3
    """Weight epsilon_3 of D_cc, the distance to the centroid of all relays."""
    capacity: int = 0
    """Most UAVs that one relay serves; 0 means ceil((n_m + n_d) / n_c) (ours)."""
    cost_distance: ClassVar[float] = 1.0
    """Weight of the distance, as a share of the field's diagonal, in the assignment cost (W3)."""
    cost_link: ClassVar[float] = 1.0
    """Weight of the free-space loss, as a share of the loss at the field's diagonal, in the assignment cost (W3)."""
    require_link: bool = False
    """Whether images and packets count only while the UAV's relay is within link_range (W4)."""
    link_range: float = 150.0
    """Range of the UAV-UAV link for require_link, m (ours)."""
    base: Literal["", "north", "east", "south", "west"] = ""
    """Edge of the field at whose middle a base station stands; with it, images and packets count only while hops over
    relays lead to it. Empty for none (ours)."""
    hop_range: float = 200.0
    """Range of the links between relays, and from a relay to the base station, m (ours)."""

    def __post_init__(self) -> None:
        """Refuse negative capacities, and ranges that are none."""
        not_negative(capacity=self.capacity)
        positive(link_range=self.link_range, hop_range=self.hop_range)

    @property
    def chained(self) -> bool:
        """Whether links count only while the relay has a chain of hops to a base station."""
        return self.require_link and bool(self.base)

    def capacity_for(self, world: WorldConfig) -> int:
        """Return the UAVs per relay; raise ConfigError when all relays together cannot serve everybody."""
        served = world.monitoring_uavs + world.collection_uavs
        capacity = min(served, self.capacity or math.ceil(served / world.communication_uavs))
        if capacity * world.communication_uavs < served:
            raise ConfigError(
                f"relay.capacity {capacity} times {world.communication_uavs} relays cannot serve {served} UAVs."
            )
        return capacity
