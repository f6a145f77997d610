"""The weights of the reward.

A docstring that ends in "(ours)" marks a constant that the paper does not give; all others are from its Tables 1 and 2.
"""

from dataclasses import dataclass
from typing import ClassVar

from eia_sec.common.config.checks import finite


@dataclass(frozen=True)
class RewardConfig:
    """Weights alpha_1 to alpha_10 of the reward."""

    positioning: ClassVar[float] = 1.0
    """alpha_1, weight by which a relay is paid for a smaller D_c, 1/m; the printed sign pays for flying away (W1)."""
    energy: ClassVar[float] = 0.005
    """alpha_2, weight of the energy of the step, 1/J."""
    collision_risk: ClassVar[float] = 5.0
    """alpha_3, weight of the safety risk SR, 1/m."""
    boundary: ClassVar[float] = 10.0
    """alpha_4, weight of the boundary violation ACT."""
    monitoring: ClassVar[float] = 2.0
    """alpha_5, weight of the visual monitoring utility VMUF."""
    monitoring_idle: ClassVar[float] = 0.5
    """alpha_6, penalty P_M of a step without imaging utility."""
    monitoring_motivation: ClassVar[float] = 0.2
    """alpha_7, weight of the VDF motivation M_V."""
    collection: ClassVar[float] = 2.0
    """alpha_8, weight of the data collection utility DCUF."""
    collection_idle: ClassVar[float] = 0.5
    """alpha_9, penalty P_C of a step without collection utility."""
    collection_motivation: ClassVar[float] = 0.2
    """alpha_10, weight of the AoI motivation M_D."""
    relayed: float = 0.0
    """Weight of what a relay's UAVs earn and would not without their links, where `relay.require_link` (ours)."""

    def __post_init__(self) -> None:
        """Refuse a weight that is no number."""
        finite(relayed=self.relayed)
