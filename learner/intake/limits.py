"""How many chunks the intake holds, and how old their policies may be."""

from dataclasses import dataclass
from typing import Final

from common.config import RunConfig

ITERATION_CHUNKS: Final = 64
"""Queue of a learner that learns on policy; the steps of an iteration limit it first."""


@dataclass(frozen=True)
class IntakeLimits:
    """The limits of a run.

    Attributes:
        chunks: most chunks in the queue.
        most_lag: largest age of a chunk's policy when it is learned from, in parameter versions; None for no limit.
    """

    chunks: int
    most_lag: int | None

    @classmethod
    def of(cls, config: RunConfig) -> "IntakeLimits":
        """Return the limits of a run."""
        if config.learns_on_policy:
            return cls(ITERATION_CHUNKS, config.on_policy.max_lag_versions)
        return cls(config.replay.intake_chunks, config.replay.max_lag_versions or None)
