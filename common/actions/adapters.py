"""Adapters convert an actor's output to the environment's action.

`eia_sec.common.team.GroupSpec` lists the adapters of a type of agent. They are applied one after another; without any,
the output is the action. Replay stores the actor's output, and the environment gets the adapted action. Workers,
evaluation, exported models and flight nodes all read the adapters from the team's description, so they act alike.

An adapter is a frozen dataclass with the members of `ActionAdapter`. A new one also needs an entry in
`eia_sec.common.actions.descriptions` and its nodes in `eia_sec.deploy.policies.onnx_actions`. It may read anything in
the agent's own observation, for instance a mask of allowed actions.
"""

import math
import sys
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.actions import lattice
from eia_sec.common.config.checks import within
from eia_sec.common.errors import ConfigError

Float32 = NDArray[np.float32]

POSITION: Final = slice(0, 2)
"""Part of an observation that holds the agent's own position (x, y); the field spans -1 to 1."""
SIGNS: Final = slice(2, 4)
"""Part of an observation that holds the signs of mirrored axes, 1 or -1."""
GAIN: Final = 1.5
"""An output of magnitude above 1 / (2 GAIN), a third, selects the neighbouring lattice point."""
CENTRE: Final = 0.5
"""Inset of a lattice whose steps end at the cells' centres."""
NEAR: Final = 1e-6
"""Least way of an idle agent in a step, for the division by it; the field spans -1 to 1."""


class ActionAdapter(Protocol):
    """One step from an actor's output to the environment's action."""

    kind: ClassVar[str]
    """Its name in a team's description."""
    formula: ClassVar[str]
    """What it computes from observation o and action a, for users of an exported policy."""

    def require(self, observation_size: int, action_size: int) -> None:
        """Raise ConfigError unless it works with observations and actions of these sizes."""

    def output_size(self, action_size: int) -> int:
        """Return the numbers in an adapted action."""

    def adapt(self, observation: Float32, action: Float32) -> Float32:
        """Return the adapted actions.

        Args:
            observation: [..., o] float32, the observations that the actors saw.
            action: [..., a] float32 in [-1, 1], or indices of options.

        Returns:
            [..., output_size] float32.
        """

    def complaint(self, observation: Float32) -> str:
        """Return what is wrong with an observation [o] from outside the simulator, or an empty string."""

    def constants(self) -> dict[str, Any]:
        """Return the constants in `formula` by name, as plain values."""


@dataclass(frozen=True)
class Lattice:
    """The output selects one of nine neighbouring lattice points and becomes the velocity that leads there.

    Each of the two numbers selects one step back, none or one step on along its axis. Gaussian noise on an output has
    no effect until it crosses a third, and it does not add up to a drift. Lattice points are the centres of equal cells
    that fill the field; neighbours are at most one step apart. With an inset below a half the agent flies only to the
    nearest place that far inside the selected cell. See docs/explanation/method.md.

    Source: Dulac-Arnold et al. (2015), Deep reinforcement learning in large discrete action spaces, who map an actor's
    output to the nearest possible action.

    Attributes:
        columns: lattice points along x.
        rows: lattice points along y.
        reach_x: distance that full speed along x covers in a step, as a share of the field's width.
        reach_y: distance that full speed along y covers in a step, as a share of the field's depth.
        inset: distance from the selected cell's border at which a step ends, as a share of the cell; 0.5 is its centre.
    """

    kind: ClassVar[str] = "lattice"
    formula: ClassVar[str] = (
        "p = (o[:2] + 1) / 2, cell = clip(floor(p count + edge), 0, count - 1), "
        "next = clip(cell + clip(rint(gain a), -1, 1), 0, count - 1), "
        "goal = min(max(p, (next + inset) / count), (next + 1 - inset) / count), "
        "a = clip((goal - p) / reach, -1, 1)"
    )

    columns: int
    rows: int
    reach_x: float
    reach_y: float
    inset: float = CENTRE

    def __post_init__(self) -> None:
        """Refuse lattices without points, agents that cannot move, and places outside a cell or at its very border."""
        within(1, 2**20, columns=self.columns, rows=self.rows)
        within(0.01, CENTRE, inset=self.inset)
        for reach in (self.reach_x, self.reach_y):
            if not 0.0 < reach < math.inf:
                raise ConfigError(f"a lattice's reach must be positive and finite, not {reach}.")

    @classmethod
    def spanning(cls, reach_x: float, reach_y: float, parts_x: int = 1, parts_y: int = 1) -> "Lattice":
        """Return the lattice with the fewest points whose neighbours are within reach of each other.

        Each of so many equal parts of the field has equally many of them, unless the parts are smaller than a step.
        """
        return cls(fewest(reach_x, parts_x), fewest(reach_y, parts_y), reach_x, reach_y)

    def require(self, observation_size: int, action_size: int) -> None:
        """Raise ConfigError unless observations hold a position and actions have two numbers."""
        if action_size != 2 or observation_size < POSITION.stop:
            raise ConfigError("a lattice needs x and y in the observation, and actions of two numbers.")

    def output_size(self, action_size: int) -> int:
        """Return 2."""
        return 2

    def adapt(self, observation: Float32, action: Float32) -> Float32:
        """Return velocities [..., 2] as shares of full speed; they never lead beyond the outermost lattice points."""
        return self.velocity(observation[..., POSITION], action)

    def velocity(self, position: Float32, action: Float32) -> Float32:
        """Return the velocities that lead to the selected lattice points.

        Args:
            position: [..., 2] float32, the agents' positions; the field spans -1 to 1.
            action: [..., 2] float32 in [-1, 1].

        Returns:
            [..., 2] float32 in [-1, 1].
        """
        count, share = _pair(self.columns, self.rows), lattice.share_of(position)
        step = _clipped(np.rint(np.float32(GAIN) * action), np.float32(-1), np.float32(1))
        cell = lattice.cell_beside(lattice.cell_at(share, count), step, count)
        velocity: Float32 = lattice.velocity_to(
            cell, share, count, _pair(self.reach_x, self.reach_y), np.float32(self.inset)
        )
        return velocity

    def cell(self, position: Float32) -> Float32:
        """Return the column and the row of the cells, [..., 2] whole numbers, that hold positions [..., 2] float32."""
        cell: Float32 = lattice.cell_at(lattice.share_of(position), _pair(self.columns, self.rows))
        return cell

    def complaint(self, observation: Float32) -> str:
        """Return an empty string: every position has a cell."""
        return ""

    def constants(self) -> dict[str, Any]:
        """Return count, reach, gain, edge and inset."""
        count, reach = [self.columns, self.rows], [self.reach_x, self.reach_y]
        return {"count": count, "reach": reach, "gain": GAIN, "edge": lattice.EDGE, "inset": self.inset}


@dataclass(frozen=True)
class MirroredAxes:
    """The agent observes and acts along axes of its own; where such an axis opposes the field's, the action flips."""

    kind: ClassVar[str] = "mirrored axes"
    formula: ClassVar[str] = "a = -a where o[2:4] < 0"

    def require(self, observation_size: int, action_size: int) -> None:
        """Raise ConfigError unless observations hold a position and signs, and actions have two numbers."""
        if action_size != 2 or observation_size < SIGNS.stop:
            raise ConfigError("mirrored axes need x, y and their signs in the observation, and actions of two numbers.")

    def output_size(self, action_size: int) -> int:
        """Return 2."""
        return 2

    def adapt(self, observation: Float32, action: Float32) -> Float32:
        """Return the actions [..., 2] along the field's axes."""
        turned: Float32 = np.where(observation[..., SIGNS] < 0.0, -action, action)
        return turned

    def complaint(self, observation: Float32) -> str:
        """Return that a sign is not 1 or -1, or an empty string."""
        return "" if (np.abs(observation[SIGNS]) == 1.0).all() else "the signs of its axes are not 1 or -1."

    def constants(self) -> dict[str, Any]:
        """Return an empty map: the formula has no constants."""
        return {}


@dataclass(frozen=True)
class NineMoves:
    """The output is the index of one of nine moves: one step back, none or one step on along x and along y.

    It becomes the two numbers with which `Lattice` selects the neighbour.

    Attributes:
        suggestion: index of the first of nine numbers of the observation, 0 to 1, that mark the moves which the
            environment suggests; -1 if it suggests none. Fresh policies favour them as far as they are marked.
        worth: index of the first of nine numbers of the observation that say what each move is worth, about 0 to 1; -1
            if there are none. Without a suggestion, fresh policies favour what is worth more.
        harm: index of the first of nine numbers that say what harm each move does.
    """

    kind: ClassVar[str] = "nine moves"
    formula: ClassVar[str] = "a = (floor(a[0] / 3) - 1, a[0] mod 3 - 1)"
    options: ClassVar[int] = 9

    suggestion: int = -1
    worth: int = -1
    harm: int = -1

    def require(self, observation_size: int, action_size: int) -> None:
        """Raise ConfigError unless the action is one index and observations hold the suggestion and the hints."""
        if action_size != 1:
            raise ConfigError("nine moves are chosen by one index.")
        last = observation_size - self.options
        if self.suggestion != -1 and not 0 <= self.suggestion <= last:
            raise ConfigError("the observation is too short for the suggested move.")
        if self.worth != -1 and not (0 <= self.worth <= last and 0 <= self.harm <= last):
            raise ConfigError("the observation is too short for the worth and the harm of moves.")

    def output_size(self, action_size: int) -> int:
        """Return 2."""
        return 2

    def adapt(self, observation: Float32, action: Float32) -> Float32:
        """Return the steps [..., 2], each -1, 0 or 1, for indices [..., 1]."""
        along_x = np.floor(action / np.float32(3))
        return np.concatenate([along_x - np.float32(1), action - np.float32(3) * along_x - np.float32(1)], axis=-1)

    def complaint(self, observation: Float32) -> str:
        """Return an empty string: the observation does not matter."""
        return ""

    def constants(self) -> dict[str, Any]:
        """Return an empty map: the formula has no constants."""
        return {}


@dataclass(frozen=True)
class Headings:
    """The output is the index of a velocity: idle, or one of eight headings at one of three speeds.

    Index 0 is idle: the agent flies slowly back and forth along x, where the printed flight power is far below that of
    hovering. Its place says which way: on from even cells and back from odd ones, each as wide as its way in a step.
    Index 1 + 8 k + j is the speed k (slow, medium, fast) on the heading j times 45 degrees.

    Attributes:
        idle: speed of an idle agent, as a share of full speed.
        slow: lowest speed on a heading, as a share of full speed.
        medium: the next speed.
        fast: the highest speed.
        reach: distance that full speed along x covers in a step, as a share of the field's width.
        potential: index of the first of nine numbers of the observation, by which each of nine moves raises a potential
            that should be low when the episode ends; -1 if there are none. Fresh policies lower it in the last steps.
        time_left: index of the number of the observation that falls from 1 to 0 in these steps.
    """

    kind: ClassVar[str] = "headings"
    resting: ClassVar[int] = 0
    """Option that does least; a fresh policy favours it, because a heading that is chosen always ends at a border."""
    formula: ClassVar[str] = (
        "k = floor((a[0] - 1) / 8), angle = (a[0] - 1) mod 8 * pi / 4, x = o[0], "
        "back = (floor(x / way) mod 2 = 1 or x > 1 - way) and x >= way - 1, "
        "a = ((-idle if back else idle), 0) if a[0] < 1 else speeds[k] (cos angle, sin angle)"
    )
    options: ClassVar[int] = 25

    idle: float
    slow: float
    medium: float
    fast: float
    reach: float
    potential: int = -1
    time_left: int = -1

    def __post_init__(self) -> None:
        """Refuse speeds outside 0..1, and agents that cannot move."""
        within(0.0, 1.0, idle=self.idle, slow=self.slow, medium=self.medium, fast=self.fast)
        if not 0.0 < self.reach < math.inf:
            raise ConfigError(f"the reach of headings must be positive and finite, not {self.reach}.")

    def require(self, observation_size: int, action_size: int) -> None:
        """Raise ConfigError unless the action is one index and observations hold a position and the hints."""
        if action_size != 1 or observation_size < POSITION.stop:
            raise ConfigError("headings need x and y in the observation, and are chosen by one index.")
        if self.potential != -1:
            inside = 0 <= self.potential <= observation_size - NineMoves.options
            if not (inside and 0 <= self.time_left < observation_size):
                raise ConfigError("the observation is too short for the potential of moves and the time left.")

    def output_size(self, action_size: int) -> int:
        """Return 2."""
        return 2

    @property
    def way(self) -> np.float32:
        """How far an idle agent flies in a step; the field spans -1 to 1."""
        return np.float32(max(2.0 * self.idle * self.reach, NEAR))

    def adapt(self, observation: Float32, action: Float32) -> Float32:
        """Return velocities [..., 2] as shares of full speed, for indices [..., 1]."""
        x, way = observation[..., :1], self.way
        cell = np.floor(x / way)
        odd = cell - np.float32(2) * np.floor(np.float32(0.5) * cell) > np.float32(0.5)
        back = (odd | (x > np.float32(1) - way)) & ~(x < way - np.float32(1))
        idle = np.where(back, np.float32(-self.idle), np.float32(self.idle)) * _pair(1, 0)
        index = np.rint(action[..., 0]).astype(np.int64)
        velocity: Float32 = np.where(action < np.float32(1), idle, self.velocities()[np.maximum(index - 1, 0)])
        return velocity

    def velocities(self) -> Float32:
        """Return the velocities [24, 2] of the options after idle, which cannot be written to."""
        return _on_headings((self.slow, self.medium, self.fast))

    def complaint(self, observation: Float32) -> str:
        """Return an empty string: there is a velocity for every position."""
        return ""

    def constants(self) -> dict[str, Any]:
        """Return idle, way and speeds."""
        return {"idle": self.idle, "way": float(self.way), "speeds": [self.slow, self.medium, self.fast]}


@lru_cache(maxsize=256)
def _pair(x: float, y: float) -> Float32:
    """Return two numbers as an array that cannot be written to; making it takes longer than an operation on it."""
    pair = np.array([x, y], np.float32)
    pair.flags.writeable = False
    return pair


@lru_cache(maxsize=64)
def _on_headings(speeds: tuple[float, ...]) -> Float32:
    """Return the velocities on eight headings at each speed, [8 K, 2], as an array that cannot be written to."""
    angle = np.arange(8) * (math.pi / 4)
    heading = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    velocities = np.concatenate([speed * heading for speed in speeds]).astype(np.float32)
    velocities.flags.writeable = False
    return velocities


def _clipped(values: Float32, low: Float32 | np.float32, high: Float32 | np.float32) -> Float32:
    """Return values between bounds; `np.clip` takes several times as long for the few numbers of a step."""
    clipped: Float32 = np.minimum(np.maximum(values, low), high)
    return clipped


def fewest(reach: float, parts: int = 1) -> int:
    """Return the fewest equal cells that fill the field, each at most `reach` wide, as a share of the field.

    Each of so many equal parts of the field has equally many cells, unless the parts are narrower than the reach.

    Raises:
        ConfigError: the reach is too small to compute their number.
    """
    if reach * sys.float_info.max <= 1.0:
        raise ConfigError("a step at full speed covers too small a share of the field.")
    within_a_part = reach * parts
    if within_a_part > 1.0 + 1e-9:
        return max(1, math.ceil(1.0 / reach - 1e-9))
    return parts * math.ceil(1.0 / within_a_part - 1e-9)
