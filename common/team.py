"""The team layout: the types of agent, and where each agent's numbers are in a row.

A *row* holds one environment step on the wire and in replay: the concatenated observations, actions and rewards of all
agents. Types may differ in observation and action size, so a row is ragged across types and regular inside a type.
"""

import hashlib
import itertools
import json
import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.actions.adapters import ActionAdapter
from eia_sec.common.actions.descriptions import adapter_from_dict, adapter_to_dict
from eia_sec.common.config.checks import within
from eia_sec.common.errors import ConfigError, SchemaError
from eia_sec.common.names import check_name

Float32 = NDArray[np.float32]
Shape = tuple[int, ...]

MOST_NUMBERS: Final = 65_536
"""Most numbers in one agent's observation or action."""
MOST_OPTIONS: Final = 65_536
"""Most options of one branch; their indices are exact in 32-bit floats."""
MOST_BRANCHES: Final = 4096
"""Most branches of a discrete action."""


@dataclass(frozen=True)
class GroupSpec:
    """One type of agent.

    Actions are continuous, or discrete with one or more branches. A branch is a choice among a number of options, as in
    Gymnasium's Discrete (one branch) and MultiDiscrete (several).

    Attributes:
        name: the type's name, for instance "communication"; see `eia_sec.common.names`.
        count: agents of the type, n_v.
        observation_size: numbers in one agent's observation, o_v.
        action_size: numbers in one agent's action, a_v: each in [-1, 1], or the index of each branch's option.
        adapters: convert an actor's output to the environment's action, applied in this order.
        choices: number of options of each branch; empty for continuous actions.
        masked: whether the last `options` numbers of an observation say which options are legal (1) or not (0).
        image: height, width and channels of the image of bytes that an observation is, row by row, but for the mask;
            empty for a vector.
    """

    name: str
    count: int
    observation_size: int
    action_size: int
    adapters: tuple[ActionAdapter, ...] = ()
    choices: tuple[int, ...] = ()
    masked: bool = False
    image: Shape = ()

    def __post_init__(self) -> None:
        """Refuse invalid names, empty types, impossible choices or images, and adapters that do not fit the sizes."""
        check_name(self.name, "a type of agent")
        within(1, 4096, count=self.count)
        within(1, MOST_NUMBERS, observation_size=self.observation_size, action_size=self.action_size)
        for options in self.choices:
            within(1, MOST_OPTIONS, options=options)
        if self.choices and len(self.choices) != self.action_size:
            raise ConfigError(f"{len(self.choices)} branches of choices do not fit actions of {self.action_size}.")
        if self.masked and not (self.choices and self.options < self.observation_size):
            raise ConfigError("a mask needs discrete actions, and an observation besides it.")
        pixels = self.observation_size - (self.options if self.masked else 0)
        if self.image and (len(self.image) != 3 or min(self.image) < 1 or math.prod(self.image) != pixels):
            raise ConfigError(f"observations of {pixels} numbers are no image of {list(self.image)}.")
        size = self.action_size
        for adapter in self.adapters:
            adapter.require(self.observation_size, size)
            size = adapter.output_size(size)

    @property
    def options(self) -> int:
        """Number of options of all branches; 0 for continuous actions."""
        return sum(self.choices)

    @property
    def seen(self) -> Shape:
        """The shape of what a network reads: (o_v,) of a vector, or channels, height and width of an image."""
        return (self.image[2], *self.image[:2]) if self.image else (self.observation_size,)

    @property
    def environment_action_size(self) -> int:
        """Numbers in one action of the environment, after the adapters."""
        size = self.action_size
        for adapter in self.adapters:
            size = adapter.output_size(size)
        return size

    def adapt(self, observation: Float32, action: Float32) -> Float32:
        """Return the environment's actions for the actors' outputs.

        Args:
            observation: [..., o_v] float32, the actors' observations.
            action: [..., a_v] float32, the actors' outputs.

        Returns:
            [..., environment_action_size] float32; `action` itself where there are no adapters.
        """
        for adapter in self.adapters:
            action = adapter.adapt(observation, action)
        return action

    def to_dict(self) -> dict[str, Any]:
        """Return a plain description for the wire and for files."""
        return {
            "name": self.name,
            "count": self.count,
            "observation_size": self.observation_size,
            "action_size": self.action_size,
            "adapters": [adapter_to_dict(adapter) for adapter in self.adapters],
            "choices": list(self.choices),
            "masked": self.masked,
            **({"image": list(self.image)} if self.image else {}),
        }

    @classmethod
    def from_dict(cls, data: Any) -> "GroupSpec":
        """Return the group in the output of `to_dict`.

        Raises:
            TypeError, ValueError, KeyError or ConfigError: when `data` describes no group.
        """
        values = dict(data)
        adapters = tuple(adapter_from_dict(part) for part in values.pop("adapters"))
        if not all(type(values.get(name)) is int for name in ("count", "observation_size", "action_size")):
            raise ValueError("a count or a size is not a whole number")
        choices, masked = values.pop("choices"), values.pop("masked")
        if type(masked) is not bool or len(choices) > MOST_BRANCHES or any(type(size) is not int for size in choices):
            raise ValueError("choices are not whole numbers, or masked is neither true nor false")
        image = values.pop("image", [])
        if not isinstance(image, list) or any(type(size) is not int for size in image):
            raise ValueError("the sizes of an image are not whole numbers")
        values |= {"adapters": adapters, "choices": tuple(choices), "masked": masked, "image": tuple(image)}
        return cls(**values | {"name": str(values["name"])})


@dataclass(frozen=True)
class TeamSpec:
    """All types of a team, in row order.

    Attributes:
        groups: the types; a row holds all agents of the first, then all of the second, and so on.
    """

    groups: tuple[GroupSpec, ...]

    def __post_init__(self) -> None:
        """Refuse an empty team and two types of one name."""
        if not self.groups:
            raise ConfigError("a team needs at least one type of agent.")
        if len({group.name for group in self.groups}) != len(self.groups):
            raise ConfigError("two types of agent have the same name.")

    @cached_property
    def types(self) -> list[str]:
        """Names of the types in row order."""
        return [group.name for group in self.groups]

    @cached_property
    def agents(self) -> int:
        """Number of all agents."""
        return sum(group.count for group in self.groups)

    @cached_property
    def observation_size(self) -> int:
        """Numbers in one row of observations."""
        return sum(group.count * group.observation_size for group in self.groups)

    @cached_property
    def action_size(self) -> int:
        """Numbers in one row of actions."""
        return sum(group.count * group.action_size for group in self.groups)

    @cached_property
    def environment_action_size(self) -> int:
        """Numbers in one row of the environment's actions, after the adapters."""
        return sum(group.count * group.environment_action_size for group in self.groups)

    @cached_property
    def in_bytes(self) -> bool:
        """Whether rows of observations are bytes: all types see images."""
        return all(group.image for group in self.groups)

    @cached_property
    def seen(self) -> Shape:
        """The shape of the observations of all agents: numbers of a row, or of images of one size all channels."""
        if not any(group.image for group in self.groups):
            return (self.observation_size,)
        channels = sum(group.count * group.seen[0] for group in self.groups)
        return (channels, *self.groups[0].seen[1:])

    @property
    def agent_names(self) -> tuple[str, ...]:
        """Names of all agents in row order: the type and the index in it, for instance "communication_0"."""
        return tuple(f"{group.name}_{index}" for group in self.groups for index in range(group.count))

    def agent_slices(self) -> tuple[slice, ...]:
        """Return each type's slice of all agents."""
        return slices(tuple(group.count for group in self.groups))

    def observation_slices(self) -> tuple[slice, ...]:
        """Return each type's slice of a row of observations."""
        return slices(tuple(group.count * group.observation_size for group in self.groups))

    def action_slices(self) -> tuple[slice, ...]:
        """Return each type's slice of a row of actions."""
        return slices(tuple(group.count * group.action_size for group in self.groups))

    def split_observations(self, rows: Float32) -> list[Float32]:
        """Split rows [..., O] into one view [..., n_v, o_v] for each type."""
        return [
            rows[..., part].reshape(*rows.shape[:-1], group.count, group.observation_size)
            for group, part in zip(self.groups, self.observation_slices(), strict=True)
        ]

    def split_actions(self, rows: Float32) -> list[Float32]:
        """Split rows [..., A] into one view [..., n_v, a_v] for each type."""
        return [
            rows[..., part].reshape(*rows.shape[:-1], group.count, group.action_size)
            for group, part in zip(self.groups, self.action_slices(), strict=True)
        ]

    def split_environment_actions(self, rows: Float32) -> list[Float32]:
        """Split the environment's rows, after the adapters, into one view [..., n_v, numbers] for each type."""
        sizes = [group.environment_action_size for group in self.groups]
        parts = slices(tuple(group.count * size for group, size in zip(self.groups, sizes, strict=True)))
        return [
            rows[..., part].reshape(*rows.shape[:-1], group.count, size)
            for group, part, size in zip(self.groups, parts, sizes, strict=True)
        ]

    def adapt(self, observations: Float32, actions: Float32) -> Float32:
        """Return the environment's actions for the actors' outputs; see `GroupSpec.adapters`.

        Args:
            observations: rows [..., O] float32, the actors' observations.
            actions: rows [..., A] float32, the actors' outputs.

        Returns:
            rows [..., environment_action_size] float32; `actions` itself where no type has adapters.
        """
        if not any(group.adapters for group in self.groups):
            return actions
        seen, taken = self.split_observations(observations), self.split_actions(actions)
        adapted = [group.adapt(own, action) for group, own, action in zip(self.groups, seen, taken, strict=True)]
        return np.concatenate([part.reshape(*actions.shape[:-1], -1) for part in adapted], axis=-1)

    def to_dict(self) -> dict[str, Any]:
        """Return a plain description for the wire and for files."""
        return {"groups": [group.to_dict() for group in self.groups]}

    @classmethod
    def from_dict(cls, data: Any) -> "TeamSpec":
        """Return the team in the output of `to_dict`; raise SchemaError when `data` describes no team."""
        try:
            return cls(tuple(GroupSpec.from_dict(group) for group in data["groups"]))
        except (KeyError, TypeError, ValueError, OverflowError, ConfigError) as error:
            raise SchemaError(f"not a team description: {error}") from error

    @cached_property
    def digest(self) -> str:
        """Sixteen hexadecimal digits that identify this layout; equal layouts have equal digests."""
        text = json.dumps(self.to_dict(), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


@lru_cache(maxsize=256)
def slices(sizes: tuple[int, ...]) -> tuple[slice, ...]:
    """Return the slices of parts of these sizes, one after another; every step of every batch asks for them."""
    ends = itertools.accumulate(sizes, initial=0)
    return tuple(slice(a, b) for a, b in itertools.pairwise(ends))


def described(team: TeamSpec) -> str:
    """Describe a team in words: its types' agent counts, observation and action sizes, and adapters."""
    groups = []
    for group in team.groups:
        acts = f"{' x '.join(map(str, group.choices))} options" if group.choices else f"{group.action_size} outputs"
        sees = f"images of {list(group.image)}" if group.image else f"{group.observation_size} inputs"
        parts = [acts, *(["a mask"] if group.masked else []), *(adapter.kind for adapter in group.adapters)]
        groups.append(f"{group.count} {group.name} agents with {sees} ({', '.join(parts)})")
    return ", ".join(groups)
