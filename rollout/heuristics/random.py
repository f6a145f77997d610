"""Uniform random actions."""

import numpy as np

from eia_sec.common.actions.sampling import sample_options
from eia_sec.common.seeds import stream
from eia_sec.common.team import Float32, TeamSpec
from eia_sec.rollout.envs.base import Environments


class RandomPolicy:
    """Uniform actions. An episode's draws depend only on its farm and episode seeds, not on its batch."""

    def __init__(self) -> None:
        self._streams: dict[int, np.random.Generator] = {}

    def reset(self, environments: Environments, index: int) -> None:
        """Start the random stream of one environment's episode."""
        episode = environments.summary(index)
        self._streams[index] = stream("random policy", episode.farm, episode.episode)

    def act(self, environments: Environments) -> Float32:
        """Return uniform actions of the environment [E, A]: in [-1, 1], or indices of legal options."""
        team = environments.team
        size = team.environment_action_size
        rows = [self._streams[index].uniform(-1.0, 1.0, size) for index in range(len(environments.time))]
        drawn = np.stack(rows).astype(np.float32)
        if any(group.choices and not group.adapters for group in team.groups):
            _choose(team, environments.observation, drawn)
        return drawn


def _choose(team: TeamSpec, observations: Float32, drawn: Float32) -> None:
    """Replace numbers drawn from [-1, 1] by indices of legal options, for types that act by choice."""
    own, actions = team.split_observations(observations), team.split_environment_actions(drawn)
    for group, seen, action in zip(team.groups, own, actions, strict=True):
        if group.choices and not group.adapters:
            indifferent = np.zeros((*action.shape[:-1], group.options), np.float32)
            action[...] = sample_options(group, seen, indifferent, (action + np.float32(1)) / np.float32(2))[0]
