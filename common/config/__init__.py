"""Frozen configuration dataclasses; every field has a docstring with unit and symbol."""

from eia_sec.common.config.algorithms import (
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
    QmixConfig,
    ValueDecompositionConfig,
    VdnConfig,
)
from eia_sec.common.config.algorithms.network import NetworkConfig
from eia_sec.common.config.environment import EnvConfig
from eia_sec.common.config.farm import (
    BatteryConfig,
    CameraConfig,
    DynamicsConfig,
    EnergyConfig,
    FarmConfig,
    RadioConfig,
    RelayConfig,
    RewardConfig,
    StressConfig,
    WorldConfig,
)
from eia_sec.common.config.farm.control import ControlConfig
from eia_sec.common.config.farm.failures import FailureConfig
from eia_sec.common.config.farm.observation import ObservationConfig
from eia_sec.common.config.farm.wind import WindConfig
from eia_sec.common.config.farm.zones import ZoneConfig
from eia_sec.common.config.optional_sections import EliteConfig, ExplorationConfig, ReplayConfig
from eia_sec.common.config.population import PopulationConfig
from eia_sec.common.config.run import EvaluationConfig, LearnerConfig, RolloutConfig, RunConfig

__all__ = [
    "ALGORITHM_CONFIGS",
    "AlgorithmConfig",
    "BaselineConfig",
    "BatteryConfig",
    "CameraConfig",
    "ControlConfig",
    "DynamicsConfig",
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
    "NetworkConfig",
    "ObservationConfig",
    "OffPolicyConfig",
    "OnPolicyConfig",
    "PopulationConfig",
    "QmixConfig",
    "RadioConfig",
    "RelayConfig",
    "ReplayConfig",
    "RewardConfig",
    "RolloutConfig",
    "RunConfig",
    "StressConfig",
    "ValueDecompositionConfig",
    "VdnConfig",
    "WindConfig",
    "WorldConfig",
    "ZoneConfig",
]
