"""The classes of all algorithms by their names, as `eia_sec.common.config.algorithms` registers them.

Those of plug-ins are found here as well. An exception in a method of theirs becomes one sentence that names plug-in,
class and method.
"""

import pkgutil
from typing import Any, Final

from torch import Tensor

from eia_sec.common import plugins
from eia_sec.common.config.algorithms import ALGORITHMS, AlgorithmConfig, OffPolicyConfig, OnPolicyConfig
from eia_sec.common.errors import PluginError
from eia_sec.learner.off_policy.algorithm import Algorithm
from eia_sec.learner.on_policy.ppo import ActorLoss, Ppo
from eia_sec.learner.on_policy.values import GroupValue


def _learners(family: type[AlgorithmConfig]) -> dict[str, Any]:
    """Return the classes of the package's algorithms whose options are of a family."""
    own = {name: found for name, found in ALGORITHMS.items() if issubclass(found.options, family)}
    return {name: pkgutil.resolve_name(found.learner) for name, found in own.items()}


OFF_POLICY: Final[dict[str, type[Algorithm[Any]]]] = _learners(OffPolicyConfig)
"""Algorithms of this package that learn from a replay buffer, by `algorithm.name`."""
ON_POLICY: Final[dict[str, type[Ppo]]] = _learners(OnPolicyConfig)
"""Algorithms of this package that learn in iterations, by `algorithm.name`."""

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
