"""From a row of actors' outputs to the actions that a PettingZoo environment takes.

A Box is continuous: -1..1 is spread over low..high. Discrete and MultiDiscrete are choices: one branch of options for
each of their numbers, and the environment's number is the option's index plus the space's start.
"""

import itertools
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from eia_sec.common.team import MOST_BRANCHES, MOST_OPTIONS, Float32


def is_bounded_box(space: spaces.Space[Any]) -> bool:
    """Return whether a space is a box whose width is finite in 32-bit floats."""
    if not isinstance(space, spaces.Box):
        return False
    with np.errstate(over="ignore", invalid="ignore"):
        width = np.asarray(space.high, np.float32) - np.asarray(space.low, np.float32)
    return bool(np.isfinite(width).all())


def is_choice(space: spaces.Space[Any]) -> bool:
    """Return whether a space is Discrete or MultiDiscrete, of a size that can be trained."""
    options = choices_of(space)
    return 0 < len(options) <= MOST_BRANCHES and max(options) <= MOST_OPTIONS


def choices_of(space: spaces.Space[Any]) -> tuple[int, ...]:
    """Return the number of options of each branch; empty if the space is no choice."""
    if isinstance(space, spaces.Discrete):
        return (int(space.n),)
    if isinstance(space, spaces.MultiDiscrete):
        return tuple(int(options) for options in np.ravel(space.nvec))
    return ()


def action_size(space: spaces.Space[Any]) -> int:
    """Return the numbers in an actor's action for a space that can be trained."""
    return len(choices_of(space)) or int(np.prod(space.shape or ()))


class RowActions:
    """Converts the actions of all agents of an environment.

    Args:
        found: each agent's action space, in row order.
    """

    def __init__(self, found: Mapping[Any, spaces.Space[Any]]) -> None:
        self._names, self._spaces = list(found), list(found.values())
        ends = np.cumsum([0, *(action_size(space) for space in found.values())]).tolist()
        self._parts = [slice(a, b) for a, b in itertools.pairwise(ends)]
        limits = [_limits(space) for space in found.values()]
        self._low, self._high = (np.concatenate([end[side] for end in limits]) for side in (0, 1))
        self._choice = np.concatenate([np.full(action_size(s), bool(choices_of(s))) for s in found.values()])
        self._starts = _starts(self._spaces)
        self._alike = _alike_boxes(self._spaces)

    def in_range(self, action: Float32) -> Float32:
        """Return the actions within their spaces: in low..high, or whole indices of options.

        Args:
            action: [E, A] finite numbers: in -1..1, or indices of options; others are clipped.

        Returns:
            [E, A] float32.
        """
        if self._starts is not None:
            whole: Float32 = np.clip(np.rint(action), self._low, self._high)
            return whole
        share = (np.clip(action, -1.0, 1.0) + 1.0) / 2.0
        spread: Float32 = np.clip(self._low + share * (self._high - self._low), self._low, self._high)
        if not self._choice.any():
            return spread
        chosen: Float32 = np.where(self._choice, np.clip(np.rint(action), self._low, self._high), spread)
        return chosen

    def by_agent(self, row: Float32, present: Collection[Any]) -> dict[Any, Any]:
        """Return the environment's action of each agent that is present.

        Args:
            row: [A], one row of `in_range`.
            present: names of the agents that act.
        """
        taken = dict(zip(self._names, self._each(row), strict=True))
        return taken if len(present) == len(taken) else {name: taken[name] for name in self._names if name in present}

    def columns(self, rows: Float32) -> dict[Any, NDArray[Any]]:
        """Return the actions [E, ...] of each agent in all environments of a batch, in its space.

        Args:
            rows: [E, A], the result of `in_range`.
        """
        parts = zip(self._names, self._spaces, self._parts, strict=True)
        return {name: _column(rows[:, part], space) for name, space, part in parts}

    def _each(self, row: Float32) -> list[Any]:
        """Return all agents' actions in row order; teams of one kind are converted at once."""
        if self._starts is not None:
            found: list[int] = (row.astype(np.int64) + self._starts).tolist()
            return found
        if self._alike is not None:
            low, high = self._alike
            return list(np.clip(row.astype(low.dtype).reshape(low.shape), low, high))
        return [_converted(row[part], space) for space, part in zip(self._spaces, self._parts, strict=True)]


def _column(numbers: Float32, space: spaces.Space[Any]) -> NDArray[Any]:
    """Return one agent's actions [E, a] as its space wants them, [E, ...]."""
    if isinstance(space, spaces.Discrete):
        chosen: NDArray[Any] = numbers[:, 0].astype(np.int64) + space.start
        return chosen
    if isinstance(space, spaces.Box) and space.dtype in (np.float32, np.float64):
        plain = numbers.reshape(len(numbers), *space.shape).astype(space.dtype)
        inside: NDArray[Any] = np.clip(plain, space.low, space.high)
        return inside
    return np.stack([np.asarray(_converted(row, space)) for row in numbers])


def _starts(found: Sequence[spaces.Space[Any]]) -> NDArray[np.int64] | None:
    """Return the first option [agents] of each agent if all actions are Discrete, or None."""
    starts = [space.start for space in found if isinstance(space, spaces.Discrete)]
    return np.array(starts, np.int64) if len(starts) == len(found) else None


def _alike_boxes(found: Sequence[spaces.Space[Any]]) -> tuple[NDArray[Any], NDArray[Any]] | None:
    """Return the bounds [agents, ...] if all actions are boxes of one shape and floating-point type, or None."""
    boxes = [space for space in found if isinstance(space, spaces.Box) and space.dtype in (np.float32, np.float64)]
    if len(boxes) < len(found) or len({(space.shape, space.dtype) for space in boxes}) > 1 or boxes[0].shape == ():
        return None
    return np.stack([space.low for space in boxes]), np.stack([space.high for space in boxes])


def _limits(space: spaces.Space[Any]) -> tuple[Float32, Float32]:
    """Return the lowest and highest numbers [a] of an action: a box's bounds, or the first and last index."""
    if isinstance(space, spaces.Box):
        return np.ravel(space.low).astype(np.float32), np.ravel(space.high).astype(np.float32)
    last = np.array(choices_of(space), np.float32) - np.float32(1)
    return np.zeros_like(last), last


def _converted(numbers: Float32, space: spaces.Space[Any]) -> int | NDArray[Any]:
    """Return one agent's action [a] as its space wants it."""
    if isinstance(space, spaces.Discrete):
        return int(numbers[0]) + int(space.start)
    # Starts may be too large for 32-bit floats, so they are added to whole numbers.
    if not isinstance(space, spaces.Box):
        plain: NDArray[Any] = numbers.reshape(space.shape or ()).astype(space.dtype)
        return plain + space.start if isinstance(space, spaces.MultiDiscrete) else plain
    # A bound may lie within the 32-bit number that stands for it, and so may the largest whole number of the type.
    kind = int if np.issubdtype(np.dtype(space.dtype), np.integer) else float
    bounds = zip(numbers.tolist(), np.ravel(space.low).tolist(), np.ravel(space.high).tolist(), strict=True)
    inside = [min(max(kind(round(number) if kind is int else number), low), high) for number, low, high in bounds]
    return np.array(inside, space.dtype).reshape(space.shape)
