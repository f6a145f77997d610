"""The team layout: which types of agent there are and where each agent's numbers lie in a row.

A *row* is what one environment step puts on the wire and into replay: the observations of all agents, one after
another, then likewise actions and rewards. Types may differ in observation and action size, so a row is ragged
by type and regular inside one.
"""

import hashlib
import itertools
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from common.config import FarmConfig
from common.config.checks import within
from common.config.control import Control
from common.errors import ConfigError, SchemaError
from common.lattice import Lattice
from common.names import check_name

Float32 = NDArray[np.float32]

COMMUNICATION: Final = "communication"
MONITORING: Final = "monitoring"
COLLECTION: Final = "collection"
LETTERS: Final = {COMMUNICATION: "c", MONITORING: "m", COLLECTION: "d"}
"""The farm's types by the paper's letters."""

COMMUNICATION_OBSERVATION: Final = 17
"""Own (x, y); nearest relay, relay centroid, served centroid, farthest served, nearest UAV as (dx, dy, distance)."""
TASK_OBSERVATION: Final = 7
"""Besides plots and sensors: own (x, y); D_VDF or D_AoI (x, y); nearest UAV as (dx, dy, distance)."""

PLACE: Final = slice(0, 2)
"""Where an observation holds the own place, along the own axes."""
SIGNS: Final = slice(2, 4)
"""Where it holds the signs of the own axes if it is mirrored."""


@dataclass(frozen=True)
class GroupSpec:
    """One type of agent.

    Attributes:
        name: the type's name, "communication" for instance; see `common.names`.
        count: agents of the type, n_v.
        observation_size: numbers in one agent's observation.
        action_size: numbers in one agent's action, each in [-1, 1].
        lattice: what the agents steer by; none for those whose action is a velocity.
        mirrored: whether the agents see and act along axes of their own, whose signs follow the own place.
    """

    name: str
    count: int
    observation_size: int
    action_size: int
    lattice: Lattice | None = None
    mirrored: bool = False

    def __post_init__(self) -> None:
        """Refuse groups that nobody could be a member of, and a lattice for agents that do not move in a plane."""
        check_name(self.name, "a type of agent")
        within(1, 4096, count=self.count)
        within(1, 65_536, observation_size=self.observation_size, action_size=self.action_size)
        if self.lattice is not None and (self.action_size != 2 or self.observation_size < 2):
            raise ConfigError(f"{self.name} agents cannot steer by a lattice: it takes x and y, and two outputs.")
        if self.mirrored and (self.action_size != 2 or self.observation_size < SIGNS.stop):
            raise ConfigError(f"{self.name} agents cannot be mirrored: it takes x and y, their signs, and two outputs.")

    def to_list(self) -> list[Any]:
        """Return a plain description for the wire and for files."""
        lattice = None if self.lattice is None else self.lattice.to_list()
        told = [self.name, self.count, self.observation_size, self.action_size, lattice, self.mirrored]
        return told if self.mirrored else told[:5] if self.lattice else told[:4]

    @classmethod
    def from_list(cls, data: Any) -> "GroupSpec":
        """Rebuild a group from `to_list`; raise TypeError, ValueError or ConfigError when it is none."""
        name, count, observation_size, action_size, *rest = data
        if len(rest) > 2:
            raise ValueError("a group has six entries at most")
        mirrored = len(rest) > 1
        if mirrored and rest[1] is not True:
            raise ValueError("the sixth entry is true where a group has one")
        if type(name) is not str or any(type(size) is not int for size in (count, observation_size, action_size)):
            raise TypeError("a group is a name and three whole numbers")
        lattice = None if not rest or (mirrored and rest[0] is None) else Lattice.from_list(rest[0])
        return cls(name, count, observation_size, action_size, lattice, mirrored)


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

    @property
    def agent_names(self) -> tuple[str, ...]:
        """Names of all agents in row order: the type and the number inside it, "communication_0" for instance."""
        return tuple(f"{group.name}_{index}" for group in self.groups for index in range(group.count))

    def agent_slices(self) -> tuple[slice, ...]:
        """Return, for each type, where its agents lie among all agents."""
        return _slices([group.count for group in self.groups])

    def observation_slices(self) -> tuple[slice, ...]:
        """Return, for each type, where its observations lie in a row."""
        return _slices([group.count * group.observation_size for group in self.groups])

    def action_slices(self) -> tuple[slice, ...]:
        """Return, for each type, where its actions lie in a row."""
        return _slices([group.count * group.action_size for group in self.groups])

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

    def steer(self, observations: Float32, actions: Float32) -> Float32:
        """Return what the environment takes for the actors' actions: themselves, unless a lattice or mirrors say more.

        Args:
            observations: rows [E, O] float32 in which the actions were decided; those who steer by a lattice or are
                mirrored see their own place first, and the signs of their axes behind it.
            actions: rows [E, A] float32 in [-1, 1].

        Returns:
            rows [E, A] float32 in [-1, 1]; `actions` itself where nobody steers by a lattice or is mirrored.
        """
        if not any(group.lattice or group.mirrored for group in self.groups):
            return actions
        steered = actions.copy()
        seen, taken = self.split_observations(observations), self.split_actions(steered)
        for group, own, action in zip(self.groups, seen, taken, strict=True):
            if group.lattice is not None:
                action[...] = group.lattice.steer(own[..., PLACE], action)
            if group.mirrored:
                action[...] = np.where(own[..., SIGNS] < 0.0, -action, action)
        return steered

    def to_dict(self) -> dict[str, Any]:
        """Return a plain description for the wire and for files."""
        return {"groups": [g.to_list() for g in self.groups]}

    @classmethod
    def from_dict(cls, data: Any) -> "TeamSpec":
        """Rebuild a team from `to_dict`; raise SchemaError when it is none."""
        try:
            return cls(tuple(GroupSpec.from_list(group) for group in data["groups"]))
        except (KeyError, TypeError, ValueError, OverflowError, ConfigError) as error:
            raise SchemaError(f"not a team description: {error}") from error

    @cached_property
    def digest(self) -> str:
        """Sixteen hexadecimal digits that name this layout; equal layouts have equal digests."""
        text = ";".join(",".join(map(str, group.to_list())) for group in self.groups)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


def _slices(sizes: list[int]) -> tuple[slice, ...]:
    ends = np.cumsum([0, *sizes]).tolist()
    return tuple(slice(a, b) for a, b in itertools.pairwise(ends))


def farm_team(farm: FarmConfig) -> TeamSpec:
    """Return the team of a farm: communication, monitoring and data collection UAVs, in that order."""
    per_sensor = 1 if farm.observation.form == "printed" else 3
    seen = farm.observation
    plots, sensors = seen.window**2 + 2 * seen.lattice, per_sensor * seen.sensors
    sizes = (
        (COMMUNICATION, farm.world.communication_uavs, COMMUNICATION_OBSERVATION, farm.control.communication),
        (MONITORING, farm.world.monitoring_uavs, TASK_OBSERVATION + plots, farm.control.monitoring),
        (COLLECTION, farm.world.collection_uavs, TASK_OBSERVATION + sensors, farm.control.collection),
    )
    return TeamSpec(
        tuple(
            GroupSpec(
                name, count, size + 2 * seen.mirrored + _self(farm, count), 2, _steered(farm, control), seen.mirrored
            )
            for name, count, size, control in sizes
        )
    )


def _steered(farm: FarmConfig, control: Control) -> Lattice | None:
    """Return what agents with that control steer by; raise ConfigError for UAVs too slow for any lattice."""
    return Lattice.spanning(*farm.world.reach) if control == "lattice" else None


def _self(farm: FarmConfig, count: int) -> int:
    """Return how many numbers of an observation tell which agent it is and what time it is."""
    return count * farm.observation.identity + farm.observation.clock
