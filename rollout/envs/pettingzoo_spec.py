"""A PettingZoo parallel environment by its name, and its agents as a team of types."""

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import ModuleType
from typing import Any, Final, TypeAlias

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from pettingzoo import ParallelEnv

from common.config import EnvConfig
from common.errors import ConfigError
from common.names import is_name
from common.team import GroupSpec, TeamSpec

CONTINUOUS: Final = "continuous_actions"
"""The argument that asks environments with a choice, such as MPE's, for Box actions."""

NAMELESS: Final = "agent"
"""The type of agents whose names are only numbers."""

Parallel: TypeAlias = ParallelEnv[Any, Any, Any]


@dataclass(frozen=True)
class Agents:
    """The agents of an environment in row order.

    Attributes:
        names: names of the agents, type by type.
        team: layout of a row.
        low: [A] lower bounds of a row's actions; an action in [-1, 1] is scaled to low .. high.
        high: [A] upper bounds of a row's actions.
    """

    names: tuple[str, ...]
    team: TeamSpec
    low: NDArray[np.float32]
    high: NDArray[np.float32]


def make_parallel(config: EnvConfig) -> Parallel:
    """Return a new environment.

    If the agents' actions are not a Box, a second attempt passes `continuous_actions=True`.

    Raises:
        ConfigError: no environment has that name, it cannot be made with these arguments, or it is not a parallel
            environment with Box actions.
    """
    factory, keywords = _factory(config.name), config.keywords()
    environment = _made(config.name, factory, keywords)
    if _has_box_actions(environment):
        return environment
    if CONTINUOUS not in keywords:
        try:
            continuous = _made(config.name, factory, {**keywords, CONTINUOUS: True})
        except ConfigError:
            continuous = environment
        if _has_box_actions(continuous):
            return continuous
    raise ConfigError(f"{config.name} has actions other than bounded boxes; only bounded boxes can be trained.")


def describe(environment: Parallel, prefixes: Mapping[str, str]) -> Agents:
    """Return the agents of an environment, grouped into types.

    Agents form a type if their names share the longest matching prefix of the map. Without a match, agents whose names
    differ only in their number form a type. A type whose agents differ in observation or action size is split by size.

    Args:
        environment: the environment.
        prefixes: maps a prefix to its type.

    Raises:
        ConfigError: an observation cannot be flattened, or a type's name is not valid (see `common.names`).
    """
    kinds: dict[str, list[str]] = {}
    sizes = {name: _sizes(environment, name) for name in environment.possible_agents}
    plain = {name: _type_of(str(name), prefixes) for name in sizes}
    for name, kind in plain.items():
        alike = {sizes[other] for other, same in plain.items() if same == kind}
        kinds.setdefault(kind if len(alike) == 1 else f"{kind}-{sizes[name][0]}x{sizes[name][1]}", []).append(name)
    for kind, members in kinds.items():
        if not is_name(kind):
            raise ConfigError(
                f"agent {str(members[0])[:80]!r} is of type {kind[:80]!r}; a type's name is 1 to 63 letters, digits, "
                "'.', '_' or '-'; name another type with env.types."
            )
    names = tuple(name for members in kinds.values() for name in members)
    team = TeamSpec(tuple(GroupSpec(kind, len(members), *sizes[members[0]]) for kind, members in kinds.items()))
    boxes = [environment.action_space(name) for name in names]
    low, high = (np.concatenate([np.ravel(getattr(box, end)) for box in boxes]) for end in ("low", "high"))
    return Agents(names, team, low.astype(np.float32), high.astype(np.float32))


def _factory(name: str) -> Callable[..., Any]:
    module, _, member = name.partition(":")
    try:
        found: Any = importlib.import_module(module)
        for part in member.split("."):
            found = getattr(found, part, None) or importlib.import_module(f"{module}.{part}")
    except ImportError as error:
        hint = "install its package, or name its folder in PYTHONPATH"
        raise ConfigError(f"there is no environment {name}: {error} ({hint}).") from None
    except Exception as error:  # foreign code may raise anything; the user's remedy is another name
        raise ConfigError(f"{name} cannot be loaded: {type(error).__name__}: {error}.") from None
    if isinstance(found, ModuleType):
        found = getattr(found, "parallel_env", None)
    if not callable(found):
        raise ConfigError(f"{name} is neither a callable nor a module with a parallel_env.")
    factory: Callable[..., Any] = found
    return factory


def _made(name: str, factory: Callable[..., Any], keywords: Mapping[str, Any]) -> Parallel:
    try:
        environment = factory(**keywords)
    except Exception as error:  # foreign code may raise anything; the user's remedy is other arguments
        raise ConfigError(f"{name} cannot be made with {dict(keywords)}: {type(error).__name__}: {error}.") from None
    if not isinstance(environment, ParallelEnv):
        raise ConfigError(f"{name} is a {type(environment).__name__}, not a PettingZoo ParallelEnv.")
    if not environment.possible_agents:
        raise ConfigError(f"{name} does not name its possible agents.")
    return environment


def _has_box_actions(environment: Parallel) -> bool:
    found = [environment.action_space(name) for name in environment.possible_agents]
    return all(isinstance(space, spaces.Box) and bool(np.isfinite(_widths(space)).all()) for space in found)


def _widths(space: spaces.Box) -> NDArray[np.float32]:
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(space.high, np.float32) - np.asarray(space.low, np.float32)


def _sizes(environment: Parallel, name: Any) -> tuple[int, int]:
    """Return the flattened sizes of an agent's observation and action."""
    try:
        seen = spaces.flatten_space(environment.observation_space(name))
    except NotImplementedError:
        raise ConfigError(f"the observation of agent {name} cannot be flattened into numbers.") from None
    if not isinstance(seen, spaces.Box):
        raise ConfigError(f"the observation of agent {name} has no fixed length.")
    return int(np.prod(seen.shape)), int(np.prod(environment.action_space(name).shape))


def _type_of(name: str, prefixes: Mapping[str, str]) -> str:
    fitting = [prefix for prefix in prefixes if name.startswith(prefix)]
    if fitting:
        return prefixes[max(fitting, key=len)]
    return name.rstrip("0123456789").rstrip("_- ") or NAMELESS
