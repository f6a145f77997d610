"""Every algorithm by its name. To add one, write its file and add a line here and in `eia_sec.common.config`.

Those of plug-ins are found here as well. An exception in a method of theirs becomes one sentence that names plug-in,
class and method.
"""

from typing import Any, Final

from torch import Tensor

from eia_sec.common import plugins
from eia_sec.common.config import AlgorithmConfig, OnPolicyConfig
from eia_sec.common.errors import PluginError
from eia_sec.learner.off_policy.algorithm import Algorithm
from eia_sec.learner.off_policy.eia_sec import EiaSec
from eia_sec.learner.off_policy.maddpg import Maddpg
from eia_sec.learner.off_policy.masac import Masac
from eia_sec.learner.off_policy.matd3 import Matd3
from eia_sec.learner.on_policy.eia_ppo import EiaPpo
from eia_sec.learner.on_policy.ippo import Ippo
from eia_sec.learner.on_policy.mappo import Mappo
from eia_sec.learner.on_policy.ppo import ActorLoss, Ppo
from eia_sec.learner.on_policy.values import GroupValue

OFF_POLICY: Final[dict[str, type[Algorithm[Any]]]] = {
    "eia-sec": EiaSec,
    "maddpg": Maddpg,
    "matd3": Matd3,
    "masac": Masac,
}
"""Algorithms that learn from a replay buffer, by `algorithm.name`."""
ON_POLICY: Final[dict[str, type[Ppo]]] = {
    "ippo": Ippo,
    "mappo": Mappo,
    "eia-ppo": EiaPpo,
}
"""Algorithms that learn in iterations; `eia_sec.common.config.ALGORITHM_CONFIGS` has the options of both families."""

RETURNED: Final[dict[str, tuple[type, ...]]] = {
    "value_function": (GroupValue,),
    "surrogate": (Tensor,),
    "actor_loss": (ActorLoss,),
    "value_loss": (Tensor,),
    "critic_loss": (Tensor,),
    "update": (tuple, type(None)),
}
"""What methods that a plug-in's algorithm may override return."""


def on_policy(name: str) -> type[Ppo]:
    """Return the class of an algorithm that learns on policy; raise PluginError if it cannot be used."""
    found: type[Ppo] = ON_POLICY[name] if name in ON_POLICY else _of_plugin(name, Ppo)
    return found


def off_policy(name: str) -> type[Algorithm[Any]]:
    """Return the class of an algorithm that learns from a replay buffer; raise PluginError if it cannot be used."""
    found: type[Algorithm[Any]] = OFF_POLICY[name] if name in OFF_POLICY else _of_plugin(name, Algorithm)
    return found


def require_algorithm(config: AlgorithmConfig) -> None:
    """Raise PluginError unless the algorithm's class can be used."""
    if isinstance(config, OnPolicyConfig):
        on_policy(config.name)
    else:
        off_policy(config.name)


def _of_plugin(name: str, base: Any) -> Any:
    found = plugins.algorithm(name)
    assert found is not None  # else its configuration would not exist
    plugin, own = found
    if not issubclass(own, base):
        raise PluginError(
            f"plug-in {plugin}: {own.__qualname__} must derive from {base.__module__}.{base.__qualname__}, because "
            f"the options of {name} are those of an algorithm that learns {'on' if base is Ppo else 'off'} policy."
        )
    if abstract := sorted(getattr(own, "__abstractmethods__", ())):
        raise PluginError(f"plug-in {plugin}: {own.__qualname__} lacks the method {abstract[0]}.")
    overridden = {each for part in own.__mro__ if part.__module__.partition(".")[0] != "eia_sec" for each in vars(part)}
    where = f"plug-in {plugin}: {own.__module__}.{own.__qualname__}"
    guarded = {
        method: plugins.guarded(getattr(own, method), f"{where}.{method}", wanted)
        for method, wanted in RETURNED.items()
        if method in overridden
    }
    return type(own.__name__, (own,), guarded)
