"""The networks that an algorithm on policy trains: the perceptrons of this package, or those of a plug-in.

`algorithm.network.name` selects the class of its options, as `algorithm.name` selects that of an algorithm.
"""

from dataclasses import dataclass
from typing import Final

from eia_sec.common.errors import ConfigError

MLP: Final = "mlp"
"""The perceptrons of this package, whose options are the algorithm's."""


@dataclass(frozen=True)
class NetworkConfig:
    """The networks of actors and value functions. A plug-in derives the options of its network from it."""

    name: str = MLP
    """The networks: mlp, or those of a plug-in by its name for them. mlp has two hidden layers of `algorithm.hidden`
    units, or with `algorithm.memory` a GRU for the second."""


NETWORK_CONFIGS: Final[dict[str, type[NetworkConfig]]] = {MLP: NetworkConfig}
"""The configuration class of every network by its name; `eia_sec.common.plugins` adds those of plug-ins."""


def network_named(current: NetworkConfig, name: str) -> NetworkConfig:
    """Return the options of a network: the present ones if they are of this name, else its defaults.

    Raises:
        ConfigError: there is no such network.
    """
    if current.name == name:
        return current
    if name not in NETWORK_CONFIGS:
        raise ConfigError(
            f"algorithm.network.name must be one of {', '.join(NETWORK_CONFIGS)}, not {name!r}; networks of plug-ins "
            "need --plugin NAME."
        )
    return NETWORK_CONFIGS[name]()
