"""Rows of experience, the same on the wire and in replay.

A trajectory segment of T steps is T + 1 consecutive rows. Row t holds the observation before step t, and the action,
reward and flag of step t; the last row holds only the final observation. So each observation is stored once, row t + 1
holds the next observation of row t, and a segment may end anywhere, at a chunk's end or at an episode's.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.errors import SchemaError
from eia_sec.common.gru import MOST_STATE
from eia_sec.common.protocol import bfloat16
from eia_sec.common.protocol.bfloat16 import Bits
from eia_sec.common.team import Float32, TeamSpec

TRANSITION: Final = 1
"""Flag bit: a step follows this row, and the next row is its successor."""
TERMINATED: Final = 2
"""Flag bit: the step of this row ended in a terminal state; its target does not bootstrap."""
TRUNCATED: Final = 4
"""Flag bit: the time limit ended the episode with the step of this row; its target bootstraps from the successor."""

_WHOLE: Final = re.compile(
    b"(?:(?:%c++[%c%c]?+|[%c%c])%c)++" % (TRANSITION, *2 * (TRANSITION | TERMINATED, TRANSITION | TRUNCATED), 0)
)
"""Flags of whole segments: one or more steps, the last of which may end the episode, then one final row."""

LARGEST: Final = 1e7
"""Largest absolute value in a row; observations are about 1, rewards up to some hundreds."""
INFOS: Final = "infos"
"""Where means over episodes hold the numbers of an environment's infos."""
MOST_INFOS: Final = 32
"""Most numbers of an environment's infos in an episode's summary."""


Seen = Float32 | Bits | NDArray[np.uint8]
"""Observations in rows."""


def observation_type(team: TeamSpec, *, rounded: bool) -> np.dtype[Any]:
    """Return the type of the observations in rows.

    Args:
        team: the layout of the team.
        rounded: whether they are bfloat16 numbers where they are no bytes.
    """
    return np.dtype(np.uint8 if team.in_bytes else np.uint16 if rounded else np.float32)


@dataclass(frozen=True)
class Rows:
    """Consecutive rows of one or more segments.

    Attributes:
        observation: [R, O] of the type that `observation_type` says: float32; bfloat16 numbers as uint16
            (`eia_sec.common.protocol.bfloat16`) if the run says so (`RunConfig.bfloat16_observations`), which halves
            messages and memory; or bytes where all agents see images.
        action: [R, A] float32 in [-1, 1], or indices of options; zeros where no step follows.
        reward: [R, agents] float32; zeros where no step follows.
        flag: [R] uint8 of TRANSITION, TERMINATED and TRUNCATED.
        log_probability: [R, agents] float32, log-probability of each agent's action under the policy that acted, for
            algorithms that learn on policy; zeros where no step follows. None for others.
        state: [E, agents, h] float32, the actors' states before the first row of each environment; None for actors
            without memory. The rows then hold E environments, one after another, with equally many steps of each. An
            environment's later segments in the same rows begin an episode, and so with a state of 0.
    """

    observation: Seen
    action: Float32
    reward: Float32
    flag: NDArray[np.uint8]
    log_probability: Float32 | None = None
    state: Float32 | None = None

    @property
    def steps(self) -> int:
        """Environment steps in these rows."""
        return int(np.count_nonzero(self.flag & TRANSITION))

    def steps_by_environment(self) -> NDArray[np.int64]:
        """Return the rows from which steps follow, [S, E]: a column for each environment, in order of time.

        Raises:
            SchemaError: there are no states, or the rows do not hold equally many steps of so many environments.
        """
        count = 0 if self.state is None else len(self.state)
        steps = np.flatnonzero(self.flag & TRANSITION)
        if not count or not len(steps) or len(steps) % count:
            raise SchemaError(f"{len(steps)} steps are not equally many of {count} environments.")
        found = steps.reshape(count, -1).T
        if (self.flag[found[-1] + 1] & TRANSITION).any():
            raise SchemaError("a segment reaches from one environment into the next.")
        return found

    def check(self, team: TeamSpec, memory: int = 0, *, rounded: bool = False) -> None:
        """Raise SchemaError unless shapes fit the team, all numbers are finite, and flags form whole segments.

        Args:
            team: the layout of the team.
            memory: h, numbers in an actor's state; 0 for actors without memory.
            rounded: as for `observation_type`.
        """
        rows = self.flag.shape[0] if self.flag.ndim == 1 else -1
        wanted = {
            "observation": (self.observation, (rows, team.observation_size)),
            "action": (self.action, (rows, team.action_size)),
            "reward": (self.reward, (rows, team.agents)),
        }
        if self.log_probability is not None:
            wanted["log_probability"] = (self.log_probability, (rows, team.agents))
        for name, (array, shape) in wanted.items():
            own = observation_type(team, rounded=rounded)
            kind = own if name == "observation" else np.dtype(np.float32)
            if array.shape != shape or array.dtype != kind:
                raise SchemaError(f"{name} is {array.dtype}{list(array.shape)}, not {kind}{list(shape)}.")
            # One huge number would spoil Adam's moments for good.
            if not _in_range(array):
                raise SchemaError(f"{name} holds a number that is not finite or larger than {LARGEST:g}.")
        if self.flag.dtype != np.uint8 or not _WHOLE.fullmatch(self.flag.tobytes()):
            raise SchemaError("the flags do not form whole segments.")
        check_actions(self.action, team)
        self._check_state(team, memory)

    def _check_state(self, team: TeamSpec, memory: int) -> None:
        if self.state is None and not memory:
            return
        found = None if self.state is None else self.state.shape
        if (
            self.state is None
            or not memory
            or self.state.dtype != np.float32
            or self.state.shape[1:] != (team.agents, memory)
        ):
            raise SchemaError(f"the actors' state is {found}, which does not fit {team.agents} agents of {memory}.")
        if not (np.abs(self.state) <= MOST_STATE).all():
            raise SchemaError(f"the actors' state holds a number that is not finite or larger than {MOST_STATE}.")
        self.steps_by_environment()


def check_actions(rows: Float32, team: TeamSpec) -> None:
    """Raise SchemaError unless actions, rows [R, A], are in [-1, 1] or indices of options."""
    if not any(group.choices for group in team.groups):
        if rows.size and not -1.0 <= rows.min() <= rows.max() <= 1.0:
            raise SchemaError("an action lies outside [-1, 1].")
        return
    for group, action in zip(team.groups, team.split_actions(rows), strict=True):
        if not group.choices:
            if not (np.abs(action) <= 1.0).all():
                raise SchemaError("an action lies outside [-1, 1].")
        elif not ((action >= 0) & (action < np.array(group.choices)) & (action == np.floor(action))).all():
            raise SchemaError(f"a {group.name} action is not the index of an option.")


def _in_range(array: Seen) -> bool:
    """Return whether all numbers are finite and none is larger than LARGEST."""
    if array.dtype == np.uint8:
        return True
    if array.dtype == np.uint16:
        return bfloat16.within(array.view(np.uint16), LARGEST)
    # NaN propagates through min and max, and fails both comparisons.
    return bool(array.min(initial=0.0) >= -LARGEST and array.max(initial=0.0) <= LARGEST)


@dataclass(frozen=True)
class EpisodeSummary:
    """One finished episode.

    Attributes:
        farm: seed of the farm, or of another environment's scenario.
        episode: the episode's seed.
        steps: environment steps.
        reward: [agents] sum of each agent's rewards.
        metrics: the environment's episode metrics, by name; the same names for every episode.
        infos: means of the numbers in a PettingZoo environment's infos, by name; at most MOST_INFOS.
    """

    farm: int
    episode: int
    steps: int
    reward: tuple[float, ...]
    metrics: Mapping[str, float]
    infos: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Chunk:
    """Rows of all environments of a worker, and the episodes that ended in them."""

    rows: Rows
    episodes: tuple[EpisodeSummary, ...] = field(default=())
