"""The farm itself: its counts, geometry and clocks.

A docstring that ends in "(ours)" marks a constant that the paper does not give; all others are from its Tables 1 and 2.
"""

import math
from dataclasses import dataclass
from typing import ClassVar, Final, Literal

from eia_sec.common.config.checks import not_negative, positive, within
from eia_sec.common.config.farm.sites import MAX_SENSORS, Sites, check_sites
from eia_sec.common.errors import ConfigError

Density = Literal["irregular", "uniform", "clustered", "banded", "patchy", "mixed"]
"""How the sensors are distributed over the field."""
MOST_CYCLE_STEPS: Final = 2**30
"""Most steps of a counter's cycle."""


@dataclass(frozen=True)
class WorldConfig:
    """Counts, geometry and clocks of the farm."""

    communication_uavs: int = 4
    """Number of communication UAVs, n_c (1 to 64)."""
    monitoring_uavs: int = 4
    """Number of monitoring UAVs, n_m (1 to 64)."""
    collection_uavs: int = 4
    """Number of data collection UAVs, n_d (1 to 64)."""
    field_x: float = 400.0
    """Width of the task space, U_x-max, m (U_x-min is 0)."""
    field_y: float = 400.0
    """Depth of the task space, U_y-max, m (U_y-min is 0)."""
    height_communication: ClassVar[float] = 22.0
    """Flight height of the communication UAVs, H_c, m."""
    height_monitoring: ClassVar[float] = 20.0
    """Flight height of the monitoring UAVs, H_m, m."""
    height_collection: ClassVar[float] = 18.0
    """Flight height of the data collection UAVs, H_d, m."""
    speed_x_max: float = 10.0
    """Largest speed along x, V_x-max, m/s."""
    speed_y_max: float = 10.0
    """Largest speed along y, V_y-max, m/s."""
    sensors: int = 400
    """Number of wireless sensors, n_WS (1 to 10,000)."""
    sensor_spacing: float = 10.0
    """Smallest distance between two sampled sensors, m (ours)."""
    density: Density = "irregular"
    """Distribution of the sensors: hills, uniform, islands, crop rows, parcels, or one of these, by seed (ours)."""
    sites: Sites = ()
    """Measured positions, which replace sampled ones: [x, y] in m or [x, y, type]; `--farm-file` sets them (ours)."""
    sensor_cycles: tuple[int, ...] = (40, 50, 60)
    """AoI update cycle T_UA of each of the I_type sensor types, s."""
    plots_x: int = 20
    """Number of plots along x, n_px (1 to 256)."""
    plots_y: int = 20
    """Number of plots along y, n_py (1 to 256)."""
    vdf_cycle: int = 30
    """VDF update cycle t_v, s."""
    aoi_max: ClassVar[int] = 5
    """Largest age of information, AoI_max, units."""
    vdf_max: ClassVar[int] = 5
    """Largest visual data freshness counter, VDF_max, units."""
    steps: int = 500
    """Steps of one episode, lambda'_max."""
    step_seconds: float = 1.0
    """Length of one step, t_step, s."""
    start_levels: Literal["zero", "random"] = "zero"
    """AoI and VDF at the start of an episode: all 0, or uniform over 0..max (ours)."""
    collision_distance: ClassVar[float] = 2.0
    """Distance below which two UAVs at the same height are reported as a collision, m (ours)."""

    def __post_init__(self) -> None:
        """Refuse impossible counts, sizes and cycles."""
        within(
            1,
            64,
            communication_uavs=self.communication_uavs,
            monitoring_uavs=self.monitoring_uavs,
            collection_uavs=self.collection_uavs,
        )
        within(1, MAX_SENSORS, sensors=self.sensors)
        within(1, 256, plots_x=self.plots_x, plots_y=self.plots_y)
        positive(
            field_x=self.field_x,
            field_y=self.field_y,
            speed_x_max=self.speed_x_max,
            speed_y_max=self.speed_y_max,
            step_seconds=self.step_seconds,
        )
        not_negative(sensor_spacing=self.sensor_spacing)
        within(1, 1_000_000, steps=self.steps)
        if not self.sensor_cycles:
            raise ConfigError("sensor_cycles must name at least one sensor type.")
        if not math.isfinite(self.safety_distance):
            raise ConfigError(f"UAVs fly too far in a step: {self.speed_x_max} m/s and {self.speed_y_max} m/s.")
        for cycle in (*self.sensor_cycles, self.vdf_cycle):
            within(1, 1_000_000, cycle=cycle)
            steps = cycle / self.step_seconds
            within(0, MOST_CYCLE_STEPS, **{f"steps of a cycle of {cycle} s": steps})
            if abs(steps - round(steps)) > 1e-9 or round(steps) < 1:
                raise ConfigError(f"a cycle of {cycle} s is not a whole number of steps of {self.step_seconds} s.")
        check_sites(self.sites, self.sensors, self.field_x, self.field_y, len(self.sensor_cycles))

    @property
    def uavs(self) -> int:
        """Number of all UAVs, n_UAV."""
        return self.communication_uavs + self.monitoring_uavs + self.collection_uavs

    @property
    def counts(self) -> tuple[int, int, int]:
        """Numbers of UAVs of each type: n_c, n_m and n_d."""
        return self.communication_uavs, self.monitoring_uavs, self.collection_uavs

    @property
    def reach(self) -> tuple[float, float]:
        """Distance at full speed in one step, as shares of the field's width and depth."""
        return self.speed_x_max * self.step_seconds / self.field_x, self.speed_y_max * self.step_seconds / self.field_y

    @property
    def safety_distance(self) -> float:
        """Safety threshold d_safety = 2 sqrt(Vx^2 + Vy^2) t_step, m (W9)."""
        return 2.0 * math.hypot(self.speed_x_max, self.speed_y_max) * self.step_seconds
