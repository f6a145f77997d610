"""Patches of stress, in which plots and sensors need more visits for a while."""

from dataclasses import dataclass
from typing import Final

from common.config.checks import positive, within

MOST_PATCHES: Final = 64
"""Most patches of an episode."""


@dataclass(frozen=True)
class StressConfig:
    """Patches of stress, in which VDF and AoI rise faster; without patches, nothing changes."""

    patches: int = 0
    """Patches that appear during an episode, 0 to 64 (ours)."""
    radius: float = 60.0
    """Radius of a patch, m (ours)."""
    growth: int = 3
    """How many times as often counters rise in a patch: their cycle, in steps, is divided by it and rounded down, to at
    least 1 (ours)."""
    seconds: float = 200.0
    """Time after which a patch is gone, s (ours)."""

    def __post_init__(self) -> None:
        """Refuse patches that are none."""
        within(0, MOST_PATCHES, patches=self.patches)
        within(1, 1_000_000, growth=self.growth)
        positive(radius=self.radius, seconds=self.seconds)

    @property
    def some(self) -> bool:
        """Whether there is any patch."""
        return self.patches > 0
