"""The rows of one iteration, and how they are split by type of agent."""

from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
import torch
from torch import Tensor

from eia_sec.common.config import OnPolicyConfig
from eia_sec.common.errors import CheckpointError, SchemaError
from eia_sec.common.team import TeamSpec
from eia_sec.common.transitions import TRANSITION, Chunk, Rows
from eia_sec.learner.checkpoint.array_tensors import as_array, as_tensor
from eia_sec.learner.networks.side_by_side import SideBySide

FIELDS: Final = ("observation", "action", "reward", "flag", "log_probability")
STATE: Final = "state"
"""A further field of rows, where actors have memory."""


class Experience:
    """Chunks of one iteration, in the order in which they came.

    Attributes:
        steps: environment steps in them.
        lag: sum over the steps of their policies' ages when they came, in parameter versions.
    """

    def __init__(self) -> None:
        self._chunks: list[Rows] = []
        self.steps = self.lag = 0

    def add(self, chunk: Chunk, lag: int) -> None:
        """Add a chunk whose policy is `lag` versions old."""
        self._chunks.append(chunk.rows)
        self.steps += chunk.rows.steps
        self.lag += lag * chunk.rows.steps

    def rows(self) -> Rows:
        """Return all rows in one piece, in memory of its own; there must be some, with log-probabilities."""
        if len(self._chunks) > 1 or not self._chunks[0].observation.flags.writeable:
            names = fields_of(self._chunks[0])
            parts = {name: np.concatenate([getattr(rows, name) for rows in self._chunks]) for name in names}
            self._chunks = [Rows(**parts)]
        return self._chunks[0]

    def tensors(self, prefix: str) -> dict[str, Tensor]:
        """Return the rows by their names in a checkpoint, which begin with `prefix`; none if there are no rows."""
        if not self._chunks:
            return {}
        rows = self.rows()
        # Rows are never written again, so a checkpoint may share their memory.
        return {f"{prefix}.{name}": as_tensor(np.asarray(getattr(rows, name))) for name in fields_of(rows)}

    @classmethod
    def restored(
        cls, team: TeamSpec, config: OnPolicyConfig, tensors: dict[str, Tensor], prefix: str, steps: int, lag: int
    ) -> "Experience":
        """Return the experience in a checkpoint.

        Args:
            team: the layout of the team.
            config: the algorithm's configuration.
            tensors: the checkpoint's tensors.
            prefix: with which the names of the experience's tensors begin.
            steps: the environment steps that it has.
            lag: as in `Experience`.

        Raises:
            CheckpointError: when it does not fit the team or its count of steps.
        """
        found = cls()
        if steps == 0:
            return found
        names = FIELDS if config.memory == "none" else (*FIELDS, STATE)
        rows = Rows(**{name: _array(tensors, f"{prefix}.{name}") for name in names})
        try:
            rows.check(team, config.memory_size, rounded=config.bfloat16_observations)
            if rows.state is not None and len(rows.steps_by_environment()) % config.sequence_steps:
                raise SchemaError("an environment's steps are not whole sequences.")
        except SchemaError as error:
            raise CheckpointError(f"the checkpoint's {prefix} cannot be used: {error}") from error
        if rows.steps != steps:
            raise CheckpointError(f"the checkpoint's {prefix} has another number of steps than it states.")
        found._chunks, found.steps, found.lag = [rows], steps, lag
        return found


class Observations(NamedTuple):
    """The observations of some rows.

    Attributes:
        own: those of each type, [R, n_v, o_v], contiguous: rows are drawn for every minibatch, and every network would
            copy what is strided.
        team: those of all agents, [R, O], or [R, 0] where neither value functions nor states need them.
    """

    own: tuple[Tensor, ...]
    team: Tensor

    @classmethod
    def of(cls, team: TeamSpec, rows: Tensor, dtype: torch.dtype, pool: SideBySide, *, whole: bool) -> "Observations":
        """Return those of rows [R, O].

        Args:
            team: the layout of the team.
            rows: [R, O].
            dtype: what they become if they are no bytes.
            pool: does it for the types side by side.
            whole: whether a network sees those of all agents.
        """
        parts = split(team, rows)
        own = pool.run([partial(_contiguous, part, dtype) for part in parts])
        return cls(tuple(own), _as(rows, dtype) if whole else rows.new_empty(len(rows), 0))


def _contiguous(part: Tensor, dtype: torch.dtype) -> Tensor:
    return _as(part, dtype).contiguous()


def _as(rows: Tensor, dtype: torch.dtype) -> Tensor:
    """Return observations as numbers of a type; bytes stay bytes, which networks scale."""
    return rows if rows.dtype == torch.uint8 else rows.to(dtype)


def _array(tensors: dict[str, Tensor], name: str) -> Any:
    tensor = tensors.get(name)
    if tensor is None or tensor.dtype not in (torch.float32, torch.bfloat16, torch.uint8):
        raise CheckpointError(f"the checkpoint's {name} is missing or has an impossible type.")
    return as_array(tensor)


def fields_of(rows: Rows) -> tuple[str, ...]:
    """Return the names of the arrays that rows have."""
    return FIELDS if rows.state is None else (*FIELDS, STATE)


def step_rows(rows: Rows) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    """Return the indices of the rows from which a step follows."""
    return np.flatnonzero(rows.flag & TRANSITION)


def split(team: TeamSpec, rows: Tensor) -> list[Tensor]:
    """Split rows [B, O] of observations into [B, n_v, o_v] for each type."""
    sizes = [group.count * group.observation_size for group in team.groups]
    parts = torch.split(rows, sizes, dim=1)
    return [part.reshape(-1, g.count, g.observation_size) for g, part in zip(team.groups, parts, strict=True)]


def split_actions(team: TeamSpec, rows: Tensor) -> list[Tensor]:
    """Split rows [B, A] of actions into [B, n_v, a_v] for each type."""
    sizes = [group.count * group.action_size for group in team.groups]
    parts = torch.split(rows, sizes, dim=1)
    return [part.reshape(-1, g.count, g.action_size) for g, part in zip(team.groups, parts, strict=True)]
