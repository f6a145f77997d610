"""The algorithms: one configuration class for each, registered in ALGORITHM_CONFIGS.

`algorithm.name` selects the class. A class has the options that its algorithm reads and names in `sections` the other
sections that it reads, so that an option without effect is refused (`eia_sec.common.config.effect`). To add an
algorithm, write its class and add a line to ALGORITHM_CONFIGS. Equations are in docs/reference/algorithms.md, readings
A4 to A12 in docs/explanation/method.md.
"""

from dataclasses import fields
from typing import Final

from eia_sec.common.config.algorithms.base import AlgorithmConfig
from eia_sec.common.config.algorithms.off_policy import (
    BaselineConfig,
    EiaSecConfig,
    MaddpgConfig,
    MasacConfig,
    Matd3Config,
    OffPolicyConfig,
)
from eia_sec.common.config.algorithms.on_policy import EiaPpoConfig, IppoConfig, MappoConfig, OnPolicyConfig
from eia_sec.common.errors import ConfigError

__all__ = [
    "ALGORITHM_CONFIGS",
    "OPTIONAL_SECTIONS",
    "AlgorithmConfig",
    "BaselineConfig",
    "EiaPpoConfig",
    "EiaSecConfig",
    "IppoConfig",
    "MaddpgConfig",
    "MappoConfig",
    "MasacConfig",
    "Matd3Config",
    "OffPolicyConfig",
    "OnPolicyConfig",
    "algorithm_class",
    "switched",
]

ALGORITHM_CONFIGS: Final[dict[str, type[AlgorithmConfig]]] = {
    "eia-sec": EiaSecConfig,
    "maddpg": MaddpgConfig,
    "matd3": Matd3Config,
    "masac": MasacConfig,
    "ippo": IppoConfig,
    "mappo": MappoConfig,
    "eia-ppo": EiaPpoConfig,
}
"""The configuration class of every algorithm by `algorithm.name`; `learner.registry` has the learners."""
OPTIONAL_SECTIONS: Final = ("elite", "replay", "exploration")
"""Sections that only some algorithms read."""


def algorithm_class(name: str) -> type[AlgorithmConfig]:
    """Return the configuration class of an algorithm; raise ConfigError when there is none."""
    if name in ALGORITHM_CONFIGS:
        return ALGORITHM_CONFIGS[name]
    raise ConfigError(f"algorithm.name must be one of {', '.join(ALGORITHM_CONFIGS)}, not {name!r}.")


def switched(current: AlgorithmConfig, name: str) -> AlgorithmConfig:
    """Return the configuration of another algorithm with the values of the options that both inherit from one family.

    All other options take the other algorithm's defaults. So do options whose defaults differ between the two, because
    they say what an algorithm is (`eia-ppo` has networks for each agent). Families learn at different rates, so nothing
    carries over from one that learns off policy to one that learns on policy, or back.

    Raises:
        ConfigError: there is no such algorithm.
    """
    wanted = algorithm_class(name)
    if type(current) is wanted:
        return current
    shared = next(base for base in type(current).__mro__ if issubclass(wanted, base))
    if shared is AlgorithmConfig:
        return wanted(name=name)
    own, others = ({field.name: field.default for field in fields(kind)} for kind in (type(current), wanted))
    kept = {
        field.name: getattr(current, field.name) for field in fields(shared) if own[field.name] == others[field.name]
    }
    return wanted(**kept | {"name": name})
