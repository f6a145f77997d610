"""Sums of agents' step rewards, from which the elite coordinator scores them (omega, eq. (er))."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from eia_sec.common.errors import SchemaError
from eia_sec.common.team import Float32

MOST_STEPS: Final = 100_000
"""Steps at which all sums are halved, so that what agents did long ago counts less and less."""


@dataclass(frozen=True)
class RewardSums:
    """What is known of the step rewards of agents: R_v-i in noise-free episodes, r' (as learned from) in training.

    Attributes:
        steps: steps that count, with what is left of older ones.
        sums: [3, agents] float64, over these steps: R, |R| and R^2.
    """

    steps: float
    sums: NDArray[np.float64]

    @classmethod
    def none(cls, agents: int) -> "RewardSums":
        """Return the sums of no steps."""
        return cls(0.0, np.zeros((3, agents)))

    @classmethod
    def checked(cls, steps: float, sums: NDArray[np.float64] | None, agents: int) -> "RewardSums":
        """Return sums that came from elsewhere; raise SchemaError if steps of so many agents cannot have them."""
        if sums is None:
            return cls.none(agents)
        shape = sums.ndim == 2 and sums.shape == (3, agents) and sums.dtype == np.float64
        if not shape or not (0.0 <= steps < np.inf and np.isfinite(sums).all() and (sums[1:] >= 0.0).all()):
            raise SchemaError(f"sums of rewards do not fit {agents} agents.")
        return cls(float(steps), sums)

    @classmethod
    def of(cls, reward: Float32, steps: int) -> "RewardSums":
        """Return the sums of some episodes.

        Args:
            reward: [F, T, agents], zeros after the end of a shorter episode.
            steps: of all episodes.
        """
        agents = reward.shape[-1]
        return cls.none(agents).plus(reward.reshape(-1, agents), steps)

    def plus(self, reward: Float32, steps: int) -> "RewardSums":
        """Return the sums with further steps.

        Args:
            reward: [R, agents], zeros where no step follows.
            steps: how many of these rows are steps.
        """
        r = reward.astype(np.float64)
        sums = self.sums + np.stack([r.sum(axis=0), np.abs(r).sum(axis=0), np.square(r).sum(axis=0)])
        share = 0.5 if self.steps + steps > MOST_STEPS else 1.0
        return RewardSums(share * (self.steps + steps), share * sums)
