"""A PettingZoo parallel environment by its name, and its agents as a team of types."""

from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack, closing
from dataclasses import dataclass
from typing import Any, Final, NamedTuple, Protocol

from gymnasium import spaces

from eia_sec.common.config import EnvConfig
from eia_sec.common.errors import ConfigError, ContractError, EnvironmentFaultError
from eia_sec.common.names import is_name
from eia_sec.common.team import GroupSpec, Shape, TeamSpec
from eia_sec.rollout.envs.guard import Guard, factory
from eia_sec.rollout.envs.pettingzoo_actions import action_size, choices_of, is_bounded_box, is_choice
from eia_sec.rollout.envs.pettingzoo_observations import AgentView, holds_mask, informed_agents

CONTINUOUS: Final = "continuous_actions"
"""The argument that asks environments with a choice, such as MPE's, for Box actions."""

NAMELESS: Final = "agent"
"""The type of agents whose names are only numbers."""
RESERVED: Final = ("mean", "farm", "reward", "steps")
"""What results hold beside the types' own values."""
NAMED: Final = 5
"""Agents that a refusal names."""


@dataclass(frozen=True)
class Agents:
    """The agents of an environment in row order.

    Attributes:
        team: layout of a row.
        views: how each agent's observation becomes numbers, by the agent's name, type by type.
        actions: each agent's action space, by the agent's name.
    """

    team: TeamSpec
    views: dict[Any, AgentView]
    actions: dict[Any, spaces.Space[Any]]


def make_parallel(config: EnvConfig, *, boxes: bool = True, make: Callable[..., Any] | None = None) -> Guard:
    """Return a new environment.

    Args:
        config: its name and arguments.
        boxes: whether an environment whose agents do not all act in boxes is asked for boxes with
            `continuous_actions=True`. It is asked in any case if its actions cannot be trained otherwise.
        make: makes it; by default what the name says.

    Raises:
        ConfigError: no environment has that name, or its actions cannot be trained.
        ContractError: it is no parallel environment.
        EnvironmentFaultError: it cannot be imported or made.
    """
    make, keywords = make or factory(config.name), config.keywords()
    with ExitStack() as rejected:
        environment = rejected.enter_context(closing(Guard(config.name, make, keywords)))
        found = _suitable(config, make, environment, boxes=boxes)
        if found is environment:
            rejected.pop_all()
        return found


def _suitable(config: EnvConfig, make: Callable[..., Any], environment: Guard, *, boxes: bool) -> Guard:
    """Return the environment, or another one with actions in boxes; raise ConfigError if neither can be trained."""
    keywords = config.keywords()
    if _all_actions(environment, is_bounded_box) or (not boxes and _all_actions(environment, _is_trainable)):
        return environment
    if CONTINUOUS not in keywords:
        try:
            continuous = Guard(config.name, make, {**keywords, CONTINUOUS: True})
        except (ContractError, EnvironmentFaultError):
            continuous = environment
        if _all_actions(continuous, is_bounded_box):
            return continuous
        if continuous is not environment:
            continuous.close()
    if _all_actions(environment, _is_trainable):
        return environment
    raise ConfigError(
        f"{config.name} has actions other than bounded boxes, Discrete and MultiDiscrete; only these can be trained."
    )


class Describable(Protocol):
    """What tells of the agents of an environment."""

    possible_agents: list[Any]

    def observation_space(self, agent: Any, /) -> spaces.Space[Any]:
        """Return an agent's observation space."""

    def action_space(self, agent: Any, /) -> spaces.Space[Any]:
        """Return an agent's action space."""

    def reset(self, seed: int) -> tuple[Mapping[Any, Any], Mapping[Any, Any]]:
        """Begin an episode; return observations and infos by agent."""


def describe(environment: Describable, prefixes: Mapping[str, str]) -> Agents:
    """Return the agents of an environment, grouped into types.

    Agents form a type if their names share the longest matching prefix of the map. Without a match, agents whose names
    differ only in their number form a type. A type whose agents differ in their observations or actions is split.

    Args:
        environment: the environment; it is reset if its infos may hold action masks.
        prefixes: maps a prefix to its type.

    Raises:
        ConfigError: an observation cannot be flattened, or a type's name is not valid (see `eia_sec.common.names`).
    """
    views = _views(environment)
    shapes = {name: _shape(environment.action_space(name), view) for name, view in views.items()}
    plain = {name: _type_of(str(name), prefixes) for name in shapes}
    for prefix in prefixes:
        if not any(str(name).startswith(prefix) for name in shapes):
            raise ConfigError(f"env.types names the prefix {prefix!r}, but the agents are {_some(shapes)}.")
    kinds: dict[str, list[Any]] = {}
    for name, kind in plain.items():
        alike = {shapes[other] for other, same in plain.items() if same == kind}
        kinds.setdefault(kind if len(alike) == 1 else f"{kind}-{shapes[name].label}", []).append(name)
    for kind, members in kinds.items():
        if not is_name(kind):
            raise ConfigError(
                f"agent {str(members[0])[:80]!r} is of type {kind[:80]!r}; a type's name is 1 to 63 letters, digits, "
                "'.', '_' or '-'; name another type with env.types."
            )
        if kind in RESERVED:
            raise ConfigError(f"no type can be called {kind!r}, as results call something else; choose with env.types.")
    names = [name for members in kinds.values() for name in members]
    team = TeamSpec(tuple(shapes[members[0]].group(kind, len(members)) for kind, members in kinds.items()))
    return Agents(team, {name: views[name] for name in names}, {name: environment.action_space(name) for name in names})


def _some(names: Iterable[Any]) -> str:
    """Return the first names, and how many more there are."""
    texts = [str(name)[:80] for name in names]
    return ", ".join(texts[:NAMED]) + (f" and {len(texts) - NAMED} more" if len(texts) > NAMED else "")


class _Shape(NamedTuple):
    """What the agents of a type have in common."""

    observation_size: int
    action_size: int
    choices: tuple[int, ...]
    masked: bool
    image: Shape

    @property
    def label(self) -> str:
        """A suffix that distinguishes types of one name: 4x2 for a box, 4of3.3 for two branches of three options.

        That of an image has its height, width and channels: 16.16.3of5.
        """
        seen = ".".join(map(str, self.image)) or self.observation_size
        if not self.choices:
            return f"{seen}x{self.action_size}"
        branches = ".".join(map(str, self.choices))
        return f"{seen}of{branches}{'-masked' if self.masked else ''}"

    def group(self, name: str, count: int) -> GroupSpec:
        """Return the type of so many agents."""
        sizes, more = (count, self.observation_size, self.action_size), (self.choices, self.masked, self.image)
        return GroupSpec(name, *sizes, (), *more)


def _shape(space: spaces.Space[Any], view: AgentView) -> _Shape:
    return _Shape(view.size, action_size(space), choices_of(space), view.masked, view.image)


def _views(environment: Describable) -> dict[Any, AgentView]:
    """Return how each agent's observation becomes numbers, in the environment's own order."""
    agents = environment.possible_agents
    choices = {name: choices_of(environment.action_space(name)) for name in agents}
    seen = {name: environment.observation_space(name) for name in agents}
    informed: set[Any] = set()
    if any(choices[name] and not holds_mask(seen[name], choices[name]) for name in agents):
        informed = informed_agents(agents, environment.reset(seed=0)[1])
    return {name: AgentView.of(name, seen[name], choices[name], informed=name in informed) for name in agents}


def _all_actions(environment: Guard, fits: Callable[[spaces.Space[Any]], bool]) -> bool:
    return all(fits(environment.action_space(name)) for name in environment.possible_agents)


def _is_trainable(space: spaces.Space[Any]) -> bool:
    return is_bounded_box(space) or is_choice(space)


def _type_of(name: str, prefixes: Mapping[str, str]) -> str:
    fitting = [prefix for prefix in prefixes if name.startswith(prefix)]
    if fitting:
        return prefixes[max(fitting, key=len)]
    return name.rstrip("0123456789").rstrip("_- ") or NAMELESS
