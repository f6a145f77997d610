"""Stress, where plots and sensors need more visits: in patches for a while, in given areas always."""

from dataclasses import dataclass
from typing import ClassVar, Final

from eia_sec.common.config.checks import within
from eia_sec.common.config.farm.polygons import Polygon, check_polygon
from eia_sec.common.errors import ConfigError

Area = tuple[int, Polygon]
"""The growth of an area, and its corners."""
Areas = tuple[Area, ...]

MOST_PATCHES: Final = 64
"""Most patches of an episode."""
MAX_AREAS: Final = 32
"""Most areas of a farm."""
MOST_GROWTH: Final = 1_000_000
"""Largest growth."""


@dataclass(frozen=True)
class StressConfig:
    """Patches and areas in which VDF and AoI rise faster; without any, nothing changes."""

    patches: int = 0
    """Patches that appear during an episode, 0 to 64 (ours)."""
    radius: ClassVar[float] = 60.0
    """Radius of a patch, m (ours)."""
    growth: ClassVar[int] = 3
    """How many times as often counters rise in a patch: their cycle, in steps, is divided by it and rounded down, to at
    least 1 (ours)."""
    seconds: ClassVar[float] = 200.0
    """Time after which a patch is gone, s (ours)."""
    areas: Areas = ()
    """Areas in which counters rise faster from the start: [growth, corners] of each, corners [x, y] in m; `--farm-file`
    reads them from polygons with "growth" (ours)."""

    def __post_init__(self) -> None:
        """Refuse patches and areas that are none."""
        within(0, MOST_PATCHES, patches=self.patches)
        if len(self.areas) > MAX_AREAS:
            raise ConfigError(f"areas are at most {MAX_AREAS}, not {len(self.areas)}.")
        for index, (growth, corners) in enumerate(self.areas):
            within(1, MOST_GROWTH, **{f"growth of stress.areas[{index}]": growth})
            check_polygon(f"stress.areas[{index}]", corners)

    @property
    def some(self) -> bool:
        """Whether there is any patch, or any area in which counters rise faster."""
        return self.patches > 0 or bool(self.faster)

    @property
    def faster(self) -> Areas:
        """The areas in which counters rise faster; those of growth 1 change nothing."""
        return tuple(area for area in self.areas if area[0] > 1)
