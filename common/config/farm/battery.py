"""Batteries of the UAVs, and the stations that charge them."""

from dataclasses import dataclass
from typing import Final

from eia_sec.common.config.checks import not_negative, positive, within

MOST_STATIONS: Final = 64
"""Most charging stations of a farm."""
LANDING: Final = 5.0
"""Distance from a station within which a UAV that flies at most 1 m/s has landed, m (ours)."""
MOST_RESERVE: Final = 0.8
"""Largest `failsafe`. UAVs leave a station at nine tenths; with a reserve near that, they would turn back at once."""


@dataclass(frozen=True)
class BatteryConfig:
    """Batteries that flights empty; without a capacity, energy only costs reward."""

    capacity: float = 0.0
    """Charge of a full battery, with which a UAV starts, J; 0 for no batteries (ours)."""
    stations: int = 4
    """Charging stations, evenly over the field (ours)."""
    power: float = 400.0
    """Power with which a station charges each UAV that has landed, W (ours)."""
    failsafe: float = 0.0
    """Share of the capacity; when less would be left at the nearest free station, an autopilot flies the UAV there. 0
    for no autopilots (ours)."""

    def __post_init__(self) -> None:
        """Refuse batteries that are none."""
        not_negative(capacity=self.capacity)
        within(1, MOST_STATIONS, stations=self.stations)
        positive(power=self.power)
        within(0.0, MOST_RESERVE, failsafe=self.failsafe)

    @property
    def some(self) -> bool:
        """Whether there are batteries."""
        return self.capacity > 0.0

    @property
    def watched(self) -> bool:
        """Whether autopilots watch the batteries."""
        return self.some and self.failsafe > 0.0
