"""No UAV moves."""

import numpy as np

from eia_sec.common.team import Float32
from eia_sec.rollout.sim.batch import FarmBatch


class StaticPolicy:
    """Every UAV hovers where it started."""

    def reset(self, farms: FarmBatch, index: int) -> None:
        """Keep no state."""

    def act(self, farms: FarmBatch) -> Float32:
        """Return zero velocities, [E, A]."""
        return np.zeros((farms.position.shape[0], farms.team.environment_action_size), np.float32)
