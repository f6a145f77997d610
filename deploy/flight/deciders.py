"""Who decides for the whole team in a step of the farm: trained actors, or a heuristic."""

from typing import Any, Protocol

import numpy as np

from eia_sec.common.actors import TeamActors, noise_free_actions
from eia_sec.common.team import Float32
from eia_sec.rollout.followed_farm import FollowedFarm


class Decider(Protocol):
    """Decides once in each step."""

    def begin(self, farm: FollowedFarm) -> None:
        """Prepare for the episode that the farm has begun."""

    def decide(self, farm: FollowedFarm) -> Float32:
        """Return every agent's velocity [n, 2] as shares of top speed; NaN where there is no usable one."""


class ActorDecider:
    """Trained actors without noise.

    Args:
        actors: the actors, with the team's adapters.
    """

    def __init__(self, actors: TeamActors) -> None:
        self._actors = actors.noise_free()
        self._state = self._actors.initial_state(1)

    def begin(self, farm: FollowedFarm) -> None:
        """Forget what was observed."""
        self._state = self._actors.initial_state(1)

    def decide(self, farm: FollowedFarm) -> Float32:
        """Decide on one row of all agents, as in training, so that actions are bit-equal to those of training."""
        row, before = farm.observation, None if self._state is None else self._state.copy()
        parts = list(self._actors.outputs(row, self._state))
        shares = self._actors.team.adapt(row, noise_free_actions(parts))[0].reshape(-1, 2)
        # The largest of logits that are not finite has an index like any other, and tanh of infinity is 1.
        finite = np.concatenate([np.isfinite(outputs[0]).all(axis=-1) for _, _, outputs in parts])
        if self._state is not None and before is not None:
            self._state[0, ~finite] = before[0, ~finite]
        return np.where(finite[:, None], shares, np.float32(np.nan))


class HeuristicDecider:
    """A heuristic, which reads the farm's map instead of observations.

    Args:
        policy: the heuristic, see `eia_sec.rollout.heuristics.registry.heuristic`.
    """

    def __init__(self, policy: Any) -> None:
        self._policy = policy

    def begin(self, farm: FollowedFarm) -> None:
        """Prepare for the episode."""
        self._policy.reset(farm, 0)

    def decide(self, farm: FollowedFarm) -> Float32:
        """Return the heuristic's velocities."""
        shares: Float32 = self._policy.act(farm)[0].reshape(-1, 2)
        return np.where(np.isfinite(shares), shares, np.float32(np.nan))
