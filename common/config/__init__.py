"""Frozen configuration dataclasses; every field has a docstring with unit and symbol."""

from common.config.algorithms import (
    ALGORITHM_CONFIGS,
    AlgorithmConfig,
    BaselineConfig,
    EiaPpoConfig,
    EiaSecConfig,
    IppoConfig,
    MaddpgConfig,
    MappoConfig,
    MasacConfig,
    Matd3Config,
    OffPolicyConfig,
    OnPolicyConfig,
)
from common.config.environment import EnvConfig
from common.config.farm import (
    BatteryConfig,
    CameraConfig,
    EnergyConfig,
    FarmConfig,
    RadioConfig,
    RelayConfig,
    RewardConfig,
    StressConfig,
    WorldConfig,
)
from common.config.farm.control import ControlConfig
from common.config.farm.failures import FailureConfig
from common.config.farm.observation import ObservationConfig
from common.config.farm.wind import WindConfig
from common.config.farm.zones import ZoneConfig
from common.config.optional_sections import EliteConfig, ExplorationConfig, ReplayConfig
from common.config.run import EvaluationConfig, LearnerConfig, RolloutConfig, RunConfig

__all__ = [
    "ALGORITHM_CONFIGS",
    "AlgorithmConfig",
    "BaselineConfig",
    "BatteryConfig",
    "CameraConfig",
    "ControlConfig",
    "EiaPpoConfig",
    "EiaSecConfig",
    "EliteConfig",
    "EnergyConfig",
    "EnvConfig",
    "EvaluationConfig",
    "ExplorationConfig",
    "FailureConfig",
    "FarmConfig",
    "IppoConfig",
    "LearnerConfig",
    "MaddpgConfig",
    "MappoConfig",
    "MasacConfig",
    "Matd3Config",
    "ObservationConfig",
    "OffPolicyConfig",
    "OnPolicyConfig",
    "RadioConfig",
    "RelayConfig",
    "ReplayConfig",
    "RewardConfig",
    "RolloutConfig",
    "RunConfig",
    "StressConfig",
    "WindConfig",
    "WorldConfig",
    "ZoneConfig",
]
