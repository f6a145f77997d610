"""From what a PettingZoo environment shows its agents to a row of observations, action masks included.

Environments say in two ways which options are legal: an observation that is a Dict with `action_mask` and other keys,
or `infos[agent]["action_mask"]`. Either way the mask becomes the end of the agent's observation. All options count as
legal where a mask is missing, where it allows no option of a branch, and for an agent that has left.

A Box of bytes with three dimensions is an image, height by width by channels; its bytes stay bytes.
"""

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from eia_sec.common.errors import ConfigError, ContractError
from eia_sec.common.team import MOST_NUMBERS, Float32, Shape
from eia_sec.common.transitions import LARGEST
from eia_sec.rollout.envs.guard import shown

MASK: Final = "action_mask"
"""Key of a mask in an observation or in an agent's info."""
MaskSource = Literal["none", "observation", "info"]
FLOATS: Final = (np.dtype(np.float32), np.dtype(np.float64))
"""Types of which each may stand for the other; the row's own is the first."""
Numbers = NDArray[Any]
"""Numbers of type float32, or bytes."""


@dataclass(frozen=True)
class AgentView:
    """How one agent's observation becomes numbers.

    Attributes:
        space: what is flattened, without the mask.
        choices: options of each branch of the agent's action; empty without a mask.
        source: where the environment gives the mask.
        size: numbers of the observation, the mask included.
        image: height, width and channels of what is flattened; empty for what is no image.
    """

    space: spaces.Space[Any]
    choices: tuple[int, ...]
    source: MaskSource
    size: int
    image: Shape = ()

    @classmethod
    def of(cls, name: Any, space: spaces.Space[Any], choices: tuple[int, ...], *, informed: bool) -> "AgentView":
        """Return the view of an agent.

        Args:
            name: the agent's name, for errors.
            space: its observation space.
            choices: options of each branch of its action; empty for a Box.
            informed: whether infos hold its mask.

        Raises:
            ConfigError: the observation cannot be flattened.
        """
        if choices and holds_mask(space, choices):
            assert isinstance(space, spaces.Dict)
            rest = spaces.Dict([(key, part) for key, part in space.spaces.items() if key != MASK])
            return cls(rest, choices, "observation", _flat_size(name, rest) + sum(choices), _image(rest))
        if choices and informed:
            return cls(space, choices, "info", _flat_size(name, space) + sum(choices), _image(space))
        return cls(space, (), "none", _flat_size(name, space), _image(space))

    @property
    def masked(self) -> bool:
        """Whether the observation ends with a mask."""
        return self.source != "none"

    @cached_property
    def plain_types(self) -> tuple[np.dtype[Any], ...]:
        """The types of arrays that are flattened by their shape alone; empty where observations need more than that."""
        if self.masked or not isinstance(self.space, spaces.Box):
            return ()
        kind = np.dtype(self.space.dtype)
        return (kind, *(other for other in FLOATS if other != kind)) if kind in FLOATS else (kind,)

    def numbers(self, name: Any, seen: Any, info: Mapping[str, Any]) -> Numbers:
        """Return the observation [size] of an agent that is present, float32, or bytes of an image.

        Raises:
            ContractError: observation or mask do not fit the agent's spaces, or a number is not finite or larger than
                LARGEST. The sentence goes on from "NAME: METHOD returned".
        """
        try:
            if self.image:
                self._require_bytes(name, seen)
            with np.errstate(over="ignore", invalid="ignore"):
                flat: Numbers = np.asarray(spaces.flatten(self.space, seen), self._kind).reshape(-1)
        except ContractError:
            raise
        except Exception as error:  # parts of a user's observation may raise anything
            raise _misfit(name, seen, self.space, f": {error!r}") from error
        if flat.shape != (self.size - sum(self.choices),):
            raise _misfit(name, seen, self.space, f", but {flat.size} numbers")
        if not (flat.min(initial=0.0) >= -LARGEST and flat.max(initial=0.0) <= LARGEST):
            raise _beyond(name, flat)
        if self.masked:
            given = (seen if self.source == "observation" else info).get(MASK)
            flat = np.concatenate([flat, self._legal(name, given).astype(self._kind)])
        return flat

    @property
    def _kind(self) -> type[np.uint8 | np.float32]:
        return np.uint8 if self.image else np.float32

    def _require_bytes(self, name: Any, seen: Any) -> None:
        """Raise ContractError unless an image holds bytes, which flattening would make of anything."""
        held = seen[next(iter(self.space.spaces))] if isinstance(self.space, spaces.Dict) else seen
        if getattr(held, "dtype", None) != np.uint8:
            raise _misfit(name, held, self.space, f", of {getattr(held, 'dtype', type(held).__name__)} and not uint8")

    def absent(self) -> Numbers:
        """Return the observation [size] of an agent that has left: zeros, with all options legal."""
        flat = np.zeros(self.size, self._kind)
        flat[self.size - sum(self.choices) :] = 1.0
        return flat

    def _legal(self, name: Any, given: Any) -> Float32:
        options = sum(self.choices)
        if given is None:
            return np.ones(options, np.float32)
        parts = given if isinstance(given, tuple | list) else (given,)
        try:
            legal = np.concatenate([np.ravel(np.asarray(part)) for part in parts]).astype(np.bool_)
        except (TypeError, ValueError):
            legal = np.zeros(0, np.bool_)
        if legal.shape != (options,):
            raise ContractError(
                f"the action mask {shown(given)} of agent {name}; it must have a number for each of its {options} "
                "actions, 1 where it is legal."
            )
        return _with_a_way_out(legal, self.choices).astype(np.float32)


class RowObservations:
    """Converts what all agents of an environment see into a row.

    Vectors and images that come as arrays of their space's shape and type are converted and checked at once; whatever
    else comes is taken agent by agent, as is what fails the check, so that the sentence names the agent.

    Args:
        views: each agent's view, in row order.
    """

    def __init__(self, views: Mapping[Any, AgentView]) -> None:
        self.views = dict(views)
        self._absent = {name: view.absent() for name, view in views.items()}
        self._bytes = all(view.image for view in views.values())
        size = sum(view.size for view in views.values())
        self._row: Numbers = np.zeros(size, np.uint8 if self._bytes else np.float32)
        self._plain = all(view.plain_types for view in views.values())
        if self._plain:
            self._shapes = [view.space.shape for view in views.values()]
            self._types = [view.plain_types for view in views.values()]
            self._usual = [self._row.dtype] * len(views)
            self._flat = all(len(shape or ()) == 1 for shape in self._shapes)
            self._empty = [part.reshape(s) for part, s in zip(self._absent.values(), self._shapes, strict=True)]

    def row(self, observations: Mapping[Any, Any], infos: Mapping[Any, Mapping[str, Any]]) -> Numbers:
        """Return the row [O], zeros where an agent is absent; it is overwritten by the next call.

        Args:
            observations: of the agents that are present, by name.
            infos: by name, where masks may be.

        Raises:
            ContractError: as `AgentView.numbers`.
        """
        if not self._at_once(observations):
            parts = [
                view.numbers(name, observations[name], infos.get(name, {})) if name in observations else absent
                for (name, view), absent in zip(self.views.items(), self._absent.values(), strict=True)
            ]
            np.concatenate(parts, out=self._row)
        return self._row

    def _at_once(self, observations: Mapping[Any, Any]) -> bool:
        """Convert plain arrays into the row; return whether that was possible and all numbers are in range."""
        if not self._plain:
            return False
        parts = [observations.get(name, absent) for name, absent in zip(self.views, self._empty, strict=True)]
        if {*map(type, parts)} != {np.ndarray} or [part.shape for part in parts] != self._shapes:
            return False
        found = [part.dtype for part in parts]
        if found != self._usual and not all(kind in types for kind, types in zip(found, self._types, strict=True)):
            return False
        flat = parts if self._flat else [part.ravel() for part in parts]
        with nullcontext() if found == self._usual else np.errstate(over="ignore", invalid="ignore"):
            np.concatenate(flat, out=self._row, casting="unsafe")
        return self._bytes or self._in_range()

    def _in_range(self) -> bool:
        # The sum of squares is the faster test, and bounds each of its parts.
        if np.dot(self._row, self._row) <= LARGEST**2:
            return True
        return bool(np.minimum.reduce(self._row) >= -LARGEST and np.maximum.reduce(self._row) <= LARGEST)


def _misfit(name: Any, seen: Any, space: spaces.Space[Any], why: str) -> ContractError:
    return ContractError(
        f"the observation {shown(seen)} of agent {name}{why}; PettingZoo asks for one in its observation_space "
        f"{shown(space)}."
    )


def _beyond(name: Any, flat: Float32) -> ContractError:
    """Return the sentence about the first number that the learner would not take."""
    index = int(np.flatnonzero(~(np.abs(flat) <= LARGEST))[0])
    remedy = "divide it by its scale in the environment" if np.isfinite(flat[index]) else "return finite numbers"
    return ContractError(
        f"an observation of agent {name} with {flat[index]:g} at index {index}; the largest is {LARGEST:g}: {remedy}."
    )


def _image(space: spaces.Space[Any]) -> Shape:
    """Return the shape of an image; empty for anything else."""
    if isinstance(space, spaces.Dict) and len(space.spaces) == 1:
        (space,) = space.spaces.values()
    if isinstance(space, spaces.Box) and space.dtype == np.uint8 and len(space.shape) == 3:
        return tuple(map(int, space.shape))
    return ()


def holds_mask(space: spaces.Space[Any], choices: tuple[int, ...]) -> bool:
    """Return whether observations hold other keys and a mask with one number for each option."""
    if not isinstance(space, spaces.Dict) or MASK not in space.spaces or len(space.spaces) < 2:
        return False
    return _numbers(space.spaces[MASK]) == sum(choices)


def informed_agents(agents: Sequence[Any], infos: Mapping[Any, Mapping[str, Any]]) -> set[Any]:
    """Return the agents whose masks come in infos; where there are any, agents that are yet to come belong to them.

    Args:
        agents: names of all possible agents.
        infos: what a reset returned.
    """
    given = {name for name, info in infos.items() if MASK in info}
    return given | {name for name in agents if name not in infos} if given else set()


def _with_a_way_out(legal: NDArray[np.bool_], choices: tuple[int, ...]) -> NDArray[np.bool_]:
    start = 0
    for options in choices:
        branch = legal[start : start + options]
        if not branch.any():
            branch[:] = True
        start += options
    return legal


def _numbers(space: spaces.Space[Any]) -> int:
    if isinstance(space, spaces.Tuple):
        return sum(_numbers(part) for part in space.spaces)
    return int(np.prod(space.shape or ()))


def _flat_size(name: Any, space: spaces.Space[Any]) -> int:
    try:
        seen = spaces.flatten_space(space)
    except NotImplementedError:
        raise ConfigError(f"the observation of agent {name} cannot be flattened into numbers.") from None
    if not isinstance(seen, spaces.Box):
        raise ConfigError(f"the observation of agent {name} has no fixed length.")
    size = int(np.prod(seen.shape))
    if not 1 <= size <= MOST_NUMBERS:
        raise ConfigError(
            f"the observation of agent {name} has {size:,} numbers, but networks take 1 to {MOST_NUMBERS:,}; images "
            "must be made smaller, or become features, in the environment."
        )
    return size
