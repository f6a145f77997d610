"""No-fly zones: their form in a configuration, and their checks."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from eia_sec.common.config.checks import within
from eia_sec.common.config.farm.polygons import Polygon, check_polygon, inside_any
from eia_sec.common.config.farm.world import WorldConfig
from eia_sec.common.errors import ConfigError

Zones = tuple[Polygon, ...]

MAX_ZONES: Final = 32
"""Most zones of a farm, given and drawn."""
LONGEST_SIDE: Final = 80.0
"""Longest side of a drawn zone, m."""
MOST_COVERED: Final = 0.5
"""Largest share of the field inside zones."""
SAMPLES: Final = 64
"""Points along each axis at which that share is measured."""


@dataclass(frozen=True)
class ZoneConfig:
    """Parts of the field that no UAV may enter; without them, nothing changes."""

    polygons: Zones = ()
    """Given zones: the corners [x, y] of each, m; `--farm-file` reads them from polygons with "no_fly" (ours)."""
    random: int = 0
    """Number of rectangles with sides of 30 to 80 m that are drawn from the farm's seed (ours)."""

    def __post_init__(self) -> None:
        """Refuse too many zones, and corners that are none."""
        within(0, MAX_ZONES, random=self.random)
        if len(self.polygons) + self.random > MAX_ZONES:
            raise ConfigError(f"zones are at most {MAX_ZONES}, not {len(self.polygons) + self.random}.")
        for index, corners in enumerate(self.polygons):
            check_polygon(f"zones.polygons[{index}]", corners)

    @property
    def some(self) -> bool:
        """Whether there is any zone."""
        return bool(self.polygons) or self.random > 0

    @property
    def corners(self) -> tuple[int, ...]:
        """Number of corners of each zone; the drawn ones come last."""
        return (*map(len, self.polygons), *(4,) * self.random)

    def check(self, world: WorldConfig) -> None:
        """Refuse zones that leave too little of the field.

        Raises:
            ConfigError: more than half of the field may lie inside zones.
        """
        if not self.some:
            return
        share = _covered(self.polygons, world) if self.polygons else 0.0
        share += self.random * LONGEST_SIDE**2 / (world.field_x * world.field_y)
        if share > MOST_COVERED:
            raise ConfigError(f"zones may cover {share:.0%} of the field; at most {MOST_COVERED:.0%} is possible.")


def _covered(polygons: Zones, world: WorldConfig) -> float:
    """Return the share of the field that lies inside polygons."""
    share = (np.arange(SAMPLES) + 0.5) / SAMPLES
    points = np.stack(np.meshgrid(share * world.field_x, share * world.field_y), axis=-1)
    return float(inside_any(points, tuple(np.array(corners) for corners in polygons)).mean())
