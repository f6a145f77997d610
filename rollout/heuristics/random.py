"""Uniform random actions."""

import numpy as np

from common.seeds import stream
from common.team import Float32
from rollout.envs.base import Environments


class RandomPolicy:
    """Uniform actions. An episode's draws depend only on its farm and episode seeds, not on its batch."""

    def __init__(self) -> None:
        self._streams: dict[int, np.random.Generator] = {}

    def reset(self, environments: Environments, index: int) -> None:
        """Start the random stream of one environment's episode."""
        episode = environments.summary(index)
        self._streams[index] = stream("random policy", episode.farm, episode.episode)

    def act(self, environments: Environments) -> Float32:
        """Return uniform actions [E, A] in [-1, 1]."""
        size = environments.team.environment_action_size
        rows = [self._streams[index].uniform(-1.0, 1.0, size) for index in range(len(environments.time))]
        return np.stack(rows).astype(np.float32)
