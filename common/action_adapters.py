"""How an actor's output becomes the action that the environment takes.

A type of agent names its adapters in `common.team.GroupSpec`; they are applied one after another, and without any the
output is the action. Replay holds the actor's output, the environment gets the adapted action. Workers, evaluation,
exported models and flight nodes all read the adapters from the team's description, so they act alike.

An adapter is a frozen dataclass with the members of `ActionAdapter`. A new one also needs an entry in ADAPTERS and its
nodes in `deploy.policies.onnx_actions`. It may read anything in the agent's own observation, a mask of allowed actions
for instance.
"""

import math
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, ClassVar, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from common.config.checks import within
from common.errors import ConfigError

Float32 = NDArray[np.float32]

POSITION: Final = slice(0, 2)
"""Where an observation holds the agent's own position (x, y), the field from -1 to 1."""
SIGNS: Final = slice(2, 4)
"""Where the observation of an agent with mirrored axes holds the axes' signs, 1 or -1."""
GAIN: Final = 1.5
"""An output beyond 1 / (2 GAIN), a third of its range, leads to the next lattice point."""
EDGE: Final = 1e-4
"""An agent this close below the next cell, as a share of a cell, counts as inside it; rounding may put it there."""


class ActionAdapter(Protocol):
    """One step from an actor's output to the environment's action."""

    kind: ClassVar[str]
    """Its name in a team's description."""
    formula: ClassVar[str]
    """What it does with observation o and action a, for people who use an exported policy elsewhere."""

    def require(self, observation_size: int, action_size: int) -> None:
        """Raise ConfigError unless it works with observations and actions of these sizes."""

    def adapt(self, observation: Float32, action: Float32) -> Float32:
        """Return the adapted actions.

        Args:
            observation: [..., o] float32, the observations that the actors saw.
            action: [..., a] float32 in [-1, 1].

        Returns:
            [..., a] float32 in [-1, 1].
        """

    def complaint(self, observation: Float32) -> str:
        """Return what is wrong with an observation [o] from outside the simulator, or nothing."""

    def constants(self) -> dict[str, Any]:
        """Return the numbers of `formula` by name, as plain values."""


@dataclass(frozen=True)
class Lattice:
    """The output names one of nine neighbouring lattice points to fly to, and becomes the velocity that leads there.

    Each of the two numbers says whether to go back, stay or go on along its axis. Gaussian noise on an output then
    changes nothing until it crosses a third of the range, and does not add up to a drift. Lattice points lie in the
    middle of equal cells that fill the field; neighbours are at most one step apart; see docs/explanation/method.md.

    Source: an actor's output mapped to the nearest of the possible actions, Dulac-Arnold et al. (2015), Deep
    reinforcement learning in large discrete action spaces.

    Attributes:
        columns: lattice points along x.
        rows: lattice points along y.
        reach_x: what full speed along x covers in a step, as a share of the field's width.
        reach_y: the same along y, of its depth.
    """

    kind: ClassVar[str] = "lattice"
    formula: ClassVar[str] = (
        "p = (o[:2] + 1) / 2, cell = clip(floor(p count + edge), 0, count - 1), "
        "goal = (clip(cell + clip(rint(gain a), -1, 1), 0, count - 1) + 0.5) / count, "
        "a = clip((goal - p) / reach, -1, 1)"
    )

    columns: int
    rows: int
    reach_x: float
    reach_y: float

    def __post_init__(self) -> None:
        """Refuse lattices without points and agents that do not move."""
        within(1, 2**20, columns=self.columns, rows=self.rows)
        for reach in (self.reach_x, self.reach_y):
            if not 0.0 < reach < math.inf:
                raise ConfigError(f"a lattice's reach must be positive and finite, not {reach}.")

    @classmethod
    def spanning(cls, reach_x: float, reach_y: float) -> "Lattice":
        """Return the lattice with the fewest points whose neighbours are within reach of each other."""
        return cls(fewest(reach_x), fewest(reach_y), reach_x, reach_y)

    def require(self, observation_size: int, action_size: int) -> None:
        """Raise ConfigError unless observations hold a position and actions have two numbers."""
        if action_size != 2 or observation_size < POSITION.stop:
            raise ConfigError("a lattice needs x and y in the observation, and actions of two numbers.")

    def adapt(self, observation: Float32, action: Float32) -> Float32:
        """Return the velocities [..., 2], full speed being 1; nobody is sent beyond the outermost lattice points."""
        return self.velocity(observation[..., POSITION], action)

    def velocity(self, position: Float32, action: Float32) -> Float32:
        """Return the velocities that lead to the lattice points that actions name.

        Args:
            position: [..., 2] float32, where the agents are, the field from -1 to 1.
            action: [..., 2] float32 in [-1, 1].

        Returns:
            [..., 2] float32 in [-1, 1].
        """
        count = np.array([self.columns, self.rows], np.float32)
        reach = np.array([self.reach_x, self.reach_y], np.float32)
        last = count - np.float32(1)
        share = (position + np.float32(1)) * np.float32(0.5)
        cell = np.clip(np.floor(share * count + np.float32(EDGE)), 0, last)
        step = np.clip(np.rint(np.float32(GAIN) * action), -1, 1)
        goal = (np.clip(cell + step, 0, last) + np.float32(0.5)) / count
        velocity: Float32 = np.clip((goal - share) / reach, np.float32(-1), np.float32(1))
        return velocity

    def complaint(self, observation: Float32) -> str:
        """Return nothing: every position has a cell."""
        return ""

    def constants(self) -> dict[str, Any]:
        """Return count, reach, gain and edge."""
        count, reach = [self.columns, self.rows], [self.reach_x, self.reach_y]
        return {"count": count, "reach": reach, "gain": GAIN, "edge": EDGE}


@dataclass(frozen=True)
class MirroredAxes:
    """The agent sees and acts along axes of its own; an action against the field's axis is negated."""

    kind: ClassVar[str] = "mirrored axes"
    formula: ClassVar[str] = "a = -a where o[2:4] < 0"

    def require(self, observation_size: int, action_size: int) -> None:
        """Raise ConfigError unless observations hold a position and signs, and actions have two numbers."""
        if action_size != 2 or observation_size < SIGNS.stop:
            raise ConfigError("mirrored axes need x, y and their signs in the observation, and actions of two numbers.")

    def adapt(self, observation: Float32, action: Float32) -> Float32:
        """Return the actions [..., 2] along the field's axes."""
        turned: Float32 = np.where(observation[..., SIGNS] < 0.0, -action, action)
        return turned

    def complaint(self, observation: Float32) -> str:
        """Return that the signs are none, or nothing."""
        return "" if (np.abs(observation[SIGNS]) == 1.0).all() else "the signs of its axes are not 1 or -1."

    def constants(self) -> dict[str, Any]:
        """Return nothing: the formula has no numbers of its own."""
        return {}


ADAPTERS: Final[dict[str, type[Lattice] | type[MirroredAxes]]] = {
    Lattice.kind: Lattice,
    MirroredAxes.kind: MirroredAxes,
}
"""Every kind of adapter by its name."""


def adapter_to_dict(adapter: ActionAdapter) -> dict[str, Any]:
    """Return a plain description for the wire and for files."""
    return {"kind": adapter.kind, **asdict(adapter)}  # type: ignore[call-overload]  # every adapter is a dataclass


def adapter_from_dict(data: Any) -> ActionAdapter:
    """Rebuild an adapter from `adapter_to_dict`.

    Raises:
        ConfigError: when it is none.
    """
    if not isinstance(data, Mapping) or (kind := ADAPTERS.get(str(data.get("kind")))) is None:
        raise ConfigError("the description of an action adapter names no kind that is known.")
    wanted = {field.name: int if field.type is int else float for field in fields(kind)}
    values = {name: value for name, value in data.items() if name != "kind"}
    if values.keys() != wanted.keys():
        raise ConfigError(f"a {kind.kind} takes {', '.join(wanted) or 'no values'}.")
    for name, value in values.items():
        if type(value) is not wanted[name] and not (wanted[name] is float and type(value) is int):
            raise ConfigError(f"{name} of a {kind.kind} must be {wanted[name].__name__}.")
    numbers: dict[str, Any] = {name: wanted[name](value) for name, value in values.items()}
    return kind(**numbers)


def fewest(reach: float) -> int:
    """Return how many cells of at most `reach`, a share of the field, fill the field.

    Raises:
        ConfigError: they cannot be counted.
    """
    if reach * sys.float_info.max <= 1.0:
        raise ConfigError("a step at full speed is too small a share of the field to be computed with.")
    return max(1, math.ceil(1.0 / reach - 1e-9))
