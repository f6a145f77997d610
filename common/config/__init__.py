"""Frozen configuration dataclasses; every field has a docstring with unit and symbol."""

from common.config.control import ControlConfig
from common.config.environment import EnvConfig
from common.config.farm import (
    CameraConfig,
    EnergyConfig,
    FarmConfig,
    ObservationConfig,
    RadioConfig,
    RelayConfig,
    RewardConfig,
    WorldConfig,
)
from common.config.learning import AlgorithmConfig, EliteConfig, ExplorationConfig, ReplayConfig
from common.config.run import EvaluationConfig, LearnerConfig, RolloutConfig, RunConfig

__all__ = [
    "AlgorithmConfig",
    "CameraConfig",
    "ControlConfig",
    "EliteConfig",
    "EnergyConfig",
    "EnvConfig",
    "EvaluationConfig",
    "ExplorationConfig",
    "FarmConfig",
    "LearnerConfig",
    "ObservationConfig",
    "RadioConfig",
    "RelayConfig",
    "ReplayConfig",
    "RewardConfig",
    "RolloutConfig",
    "RunConfig",
    "WorldConfig",
]
