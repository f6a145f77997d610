"""The algorithms, each a line of ALGORITHMS: its name, its learner and the class of its options.

`algorithm.name` selects the line. A class of options has those that its algorithm reads and names in `sections` the
other sections that it reads, so that an option without effect is refused (`eia_sec.common.config.effect`). Equations
are in docs/reference/algorithms.md, readings A4 to A12 in docs/explanation/method.md.
"""

from dataclasses import fields
from typing import Final, NamedTuple

from eia_sec.common.config.algorithms.base import AlgorithmConfig, named
from eia_sec.common.config.algorithms.off_policy import (
    BaselineConfig,
    EiaSecConfig,
    MaddpgConfig,
    MasacConfig,
    Matd3Config,
    OffPolicyConfig,
    QmixConfig,
    ValueDecompositionConfig,
    VdnConfig,
)
from eia_sec.common.config.algorithms.on_policy import EiaPpoConfig, IppoConfig, MappoConfig, OnPolicyConfig
from eia_sec.common.errors import ConfigError
from eia_sec.common.spelling import did_you_mean

__all__ = [
    "ALGORITHMS",
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
    "QmixConfig",
    "ValueDecompositionConfig",
    "VdnConfig",
    "algorithm_class",
    "switched",
]


class RegisteredAlgorithm(NamedTuple):
    """An algorithm of this package.

    Attributes:
        learner: module:name of its class. Only the learner imports it, because it loads torch.
        options: the class of its options. One that has no options of its own takes those of another algorithm.
    """

    learner: str
    options: type[AlgorithmConfig]


ALGORITHMS: Final[dict[str, RegisteredAlgorithm]] = {
    "eia-sec": RegisteredAlgorithm("eia_sec.learner.off_policy.eia_sec:EiaSec", EiaSecConfig),
    "maddpg": RegisteredAlgorithm("eia_sec.learner.off_policy.maddpg:Maddpg", MaddpgConfig),
    "matd3": RegisteredAlgorithm("eia_sec.learner.off_policy.matd3:Matd3", Matd3Config),
    "masac": RegisteredAlgorithm("eia_sec.learner.off_policy.masac:Masac", MasacConfig),
    "vdn": RegisteredAlgorithm("eia_sec.learner.off_policy.vdn:Vdn", VdnConfig),
    "qmix": RegisteredAlgorithm("eia_sec.learner.off_policy.qmix:Qmix", QmixConfig),
    "ippo": RegisteredAlgorithm("eia_sec.learner.on_policy.ippo:Ippo", IppoConfig),
    "mappo": RegisteredAlgorithm("eia_sec.learner.on_policy.mappo:Mappo", MappoConfig),
    "eia-ppo": RegisteredAlgorithm("eia_sec.learner.on_policy.eia_ppo:EiaPpo", EiaPpoConfig),
}
"""The algorithms of this package by `algorithm.name`. To add one, write its file and add a line here."""
ALGORITHM_CONFIGS: Final[dict[str, type[AlgorithmConfig]]] = {
    name: named(found.options, name) for name, found in ALGORITHMS.items()
}
"""The class of every algorithm's options by `algorithm.name`; `eia_sec.common.plugins` adds those of plug-ins."""
OPTIONAL_SECTIONS: Final = ("elite", "replay", "exploration")
"""Sections that only some algorithms read."""


def algorithm_class(name: str) -> type[AlgorithmConfig]:
    """Return the configuration class of an algorithm; raise ConfigError when there is none."""
    if name in ALGORITHM_CONFIGS:
        return ALGORITHM_CONFIGS[name]
    meant = did_you_mean(name, ALGORITHM_CONFIGS) or "."
    raise ConfigError(f"algorithm.name must be one of {', '.join(ALGORITHM_CONFIGS)}, not {name!r}{meant}")


def switched(current: AlgorithmConfig, name: str) -> AlgorithmConfig:
    """Return the configuration of another algorithm with the values of the options that both have from one family.

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
    names = [field.name for field in fields(shared) if field.name not in wanted.unread]
    kept = {name: getattr(current, name) for name in names if own[name] == others[name]}
    return wanted(**kept | {"name": name})
