"""Wind over the field: a steady part and gusts."""

from dataclasses import dataclass
from typing import ClassVar, Final

from eia_sec.common.config.checks import within
from eia_sec.common.config.farm.world import WorldConfig
from eia_sec.common.errors import ConfigError

STRONGEST: Final = 1e3
"""Largest speed and deviation, m/s."""


@dataclass(frozen=True)
class WindConfig:
    """Wind, the same over the whole field; without it, nothing changes."""

    speed: float = 0.0
    """Speed of the steady wind, m/s, at most the UAVs' top speed along each axis. Its direction follows from the
    episode's seed (ours)."""
    gusts: float = 0.0
    """Standard deviation of the gusts along each axis, m/s; 0 for none (ours)."""
    gust_seconds: ClassVar[float] = 10.0
    """Time after which a gust's correlation has fallen to 1/e, s (ours)."""

    def __post_init__(self) -> None:
        """Refuse negative speeds."""
        within(0.0, STRONGEST, speed=self.speed, gusts=self.gusts)

    @property
    def some(self) -> bool:
        """Whether any wind blows."""
        return self.speed > 0.0 or self.gusts > 0.0

    def check(self, world: WorldConfig) -> None:
        """Refuse a steady wind that blows UAVs away.

        Raises:
            ConfigError: it is faster than the UAVs along an axis.
        """
        slowest = min(world.speed_x_max, world.speed_y_max)
        if self.speed > slowest:
            raise ConfigError(f"wind.speed {self.speed:g} exceeds the UAVs' top speed of {slowest:g} m/s.")
