"""The farm: every constant of the paper's system model, with its symbol and unit; one module a section."""

from dataclasses import dataclass, field

from eia_sec.common.config.farm.battery import BatteryConfig
from eia_sec.common.config.farm.control import ControlConfig
from eia_sec.common.config.farm.dynamics import DynamicsConfig
from eia_sec.common.config.farm.equipment import CameraConfig, EnergyConfig, RadioConfig
from eia_sec.common.config.farm.failures import FailureConfig
from eia_sec.common.config.farm.observation import ObservationConfig
from eia_sec.common.config.farm.relay import RelayConfig
from eia_sec.common.config.farm.reward import RewardConfig
from eia_sec.common.config.farm.stress import StressConfig
from eia_sec.common.config.farm.wind import WindConfig
from eia_sec.common.config.farm.world import WorldConfig
from eia_sec.common.config.farm.zones import ZoneConfig
from eia_sec.common.errors import ConfigError

__all__ = [
    "BatteryConfig",
    "CameraConfig",
    "ControlConfig",
    "DynamicsConfig",
    "EnergyConfig",
    "FailureConfig",
    "FarmConfig",
    "ObservationConfig",
    "RadioConfig",
    "RelayConfig",
    "RewardConfig",
    "StressConfig",
    "WindConfig",
    "WorldConfig",
    "ZoneConfig",
]


@dataclass(frozen=True)
class FarmConfig:
    """The whole simulated farm."""

    world: WorldConfig = field(default_factory=WorldConfig)
    radio: RadioConfig = field(default_factory=RadioConfig)
    camera: CameraConfig = field(default_factory=CameraConfig)
    energy: EnergyConfig = field(default_factory=EnergyConfig)
    relay: RelayConfig = field(default_factory=RelayConfig)
    reward: RewardConfig = field(default_factory=RewardConfig)
    observation: ObservationConfig = field(default_factory=ObservationConfig)
    control: ControlConfig = field(default_factory=ControlConfig)
    dynamics: DynamicsConfig = field(default_factory=DynamicsConfig)
    failures: FailureConfig = field(default_factory=FailureConfig)
    stress: StressConfig = field(default_factory=StressConfig)
    battery: BatteryConfig = field(default_factory=BatteryConfig)
    wind: WindConfig = field(default_factory=WindConfig)
    zones: ZoneConfig = field(default_factory=ZoneConfig)

    def __post_init__(self) -> None:
        """Refuse sections that contradict each other."""
        self.relay.capacity_for(self.world)
        self.failures.check(self.world.counts, self.world.steps)
        self.wind.check(self.world)
        self.zones.check(self.world)
        self.dynamics.check(self.world.step_seconds)
        if self.dynamics.inertial and (self.observation.route or self.observation.plan > 0):
            raise ConfigError(
                "observation.route and observation.plan lead from one lattice point to the next, which takes "
                "dynamics.model instant; with inertial set them to false and 0."
            )
        if self.observation.sensors > self.world.sensors:
            raise ConfigError(
                f"observation.sensors {self.observation.sensors} exceeds the {self.world.sensors} sensors there are."
            )

    @property
    def loses_uavs(self) -> bool:
        """Whether a UAV can be gone before the end: it is missing, it fails, or its battery is empty."""
        return self.failures.some or self.battery.some

    @property
    def loses_in_flight(self) -> bool:
        """Whether a UAV can be lost in flight, so that the others observe how many are left."""
        return self.failures.in_flight or self.battery.some
