"""Options of the losses; every process reads them, so this module loads no torch."""

from dataclasses import dataclass

from eia_sec.common.config import IppoConfig, MaddpgConfig


@dataclass(frozen=True)
class SmoothOptions(IppoConfig):
    """PPO with a penalty in place of the clip."""

    penalty: float = 2.0
    """Weight of the squared distance of the ratio from 1."""


@dataclass(frozen=True)
class BoldOptions(MaddpgConfig):
    """MADDPG whose critics forgive what turned out better than they thought."""

    optimism: float = 0.5
    """Weight of errors where the target is higher."""
