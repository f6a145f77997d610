"""How many chunks the intake holds, and how old their policies may be."""

import math
from dataclasses import dataclass
from typing import Final

from eia_sec.common.config import RunConfig

ITERATION_CHUNKS: Final = 64
"""Least queue of a learner that learns on policy; it always holds the chunks of an iteration."""
LEAST_HORIZONS: Final = 3.0
"""Length of the shortest chunk that workers are asked for, in horizons 1 / (1 - gamma lambda). Advantages end with
their chunk; what follows is left to the value function."""
DRAINED_CHUNKS: Final = 1024
"""Most chunks that a draining learner takes in; with those of two iterations they bound a checkpoint's size."""


@dataclass(frozen=True)
class IntakeLimits:
    """The limits of a run.

    Attributes:
        chunks: most chunks in the queue.
        most_lag: largest age of a chunk's policy when it is learned from, in parameter versions; None for no limit.
        iteration_steps: environment steps of an iteration (on policy).
        chunk_steps: environment steps of a whole chunk.
        least_steps: environment steps of the shortest chunk that workers are asked for; None for whole chunks only.
    """

    chunks: int
    most_lag: int | None
    iteration_steps: int = 0
    chunk_steps: int = 1
    least_steps: int | None = None

    @classmethod
    def of(cls, config: RunConfig) -> "IntakeLimits":
        """Return the limits of a run."""
        chunk = config.rollout.environments * config.rollout.chunk_steps
        if config.learns_on_policy:
            whole, least = config.on_policy.iteration_steps, None
            if not (config.memory_size or any(config.on_policy.hindsight.values())):
                least = config.rollout.environments * _least_steps(config)
            chunks = max(ITERATION_CHUNKS, -(-whole // (least or chunk)))
            return cls(chunks, config.on_policy.max_lag_versions, whole, chunk, least)
        return cls(config.replay.intake_chunks, config.replay.max_age_versions or None, chunk_steps=chunk)


def _least_steps(config: RunConfig) -> int:
    """Return the steps of each environment in the shortest chunk that workers are asked for."""
    algorithm, whole = config.on_policy, config.rollout.chunk_steps
    decay = algorithm.gae_lambda * max([algorithm.discount, *algorithm.discounts.values()])
    return whole if decay >= 1.0 else min(whole, math.ceil(LEAST_HORIZONS / (1.0 - decay)))
