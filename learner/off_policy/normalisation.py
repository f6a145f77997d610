"""Running means and standard deviations of observations and rewards, for each type of agent.

A type's agents share their statistics. Observations are standardised, x = (o - mean) / std. Exported actors take raw
observations: the same map is folded into their first layers,

    W1' = W1 / std (row by row),   b1' = b1 - mean W1',

so nobody else needs the statistics. Folding is linear, so blending folded actors of one type equals folding their
blend.
"""

from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from eia_sec.common.team import Float32, TeamSpec

MIN_STD: Final = 1e-2
"""Smaller standard deviations are raised to this, so that an input that hardly ever changes is not amplified."""
Float64 = NDArray[np.float64]


class Moments:
    """Count, mean and sum of squared deviations of rows of numbers, by Chan's pairwise update.

    Attributes:
        state: float64 [1 + 2 size]: count, means, sums of squared deviations from them.
    """

    def __init__(self, size: int) -> None:
        self._size = size
        self.state = torch.zeros(1 + 2 * size, dtype=torch.float64)

    def add(self, rows: Float32) -> None:
        """Add rows [R, size]."""
        if rows.shape[0] == 0:
            return
        state, size = self.state.numpy(), self._size
        count, mean, squares = float(state[0]), state[1 : 1 + size], state[1 + size :]
        wide = rows.astype(np.float64)
        new = wide.mean(axis=0)
        gap, total = new - mean, count + rows.shape[0]
        squares += ((wide - new) ** 2).sum(axis=0) + gap**2 * (count * rows.shape[0] / total)
        mean += gap * (rows.shape[0] / total)
        state[0] = total

    def mean(self) -> Float64:
        """Return the mean [size]; 0 before any row."""
        return self.state.numpy()[1 : 1 + self._size].copy()

    def std(self) -> Float64:
        """Return the standard deviation [size], at least MIN_STD; 1 before any row."""
        state = self.state.numpy()
        if state[0] == 0:
            return np.ones(self._size)
        found: Float64 = np.maximum(np.sqrt(state[1 + self._size :] / state[0]), MIN_STD)
        return found


class Normalisation:
    """The statistics of one run.

    Args:
        team: the layout of the team.
        like: a tensor of the engine's device and type.
        observations: whether observations are standardised.
        rewards: whether rewards are divided by their standard deviation.
    """

    def __init__(self, team: TeamSpec, like: Tensor, *, observations: bool, rewards: bool) -> None:
        self._team, self.observations, self.rewards = team, observations, rewards
        self._seen = [Moments(g.observation_size) for g in team.groups] if observations else []
        self._paid = [Moments(1) for _ in team.groups] if rewards else []
        self._mean, self._scale = like.new_zeros(team.observation_size), like.new_ones(team.observation_size)
        self._reward_scale = like.new_ones(team.agents)

    def add(self, observation: Float32, reward: Float32) -> None:
        """Add rows of observations [R, O] and rewards [R, agents]."""
        for moments, rows in zip(self._seen, self._team.split_observations(observation), strict=False):
            moments.add(rows.reshape(-1, rows.shape[-1]))
        for moments, part in zip(self._paid, self._team.agent_slices(), strict=False):
            moments.add(reward[:, part].reshape(-1, 1))
        self.refresh()

    def refresh(self) -> None:
        """Recompute from the moments what updates use; call this after setting the moments from outside."""
        counts = [group.count for group in self._team.groups]
        if self._seen:
            mean = np.concatenate([np.tile(m.mean(), n) for m, n in zip(self._seen, counts, strict=True)])
            scale = np.concatenate([np.tile(1.0 / m.std(), n) for m, n in zip(self._seen, counts, strict=True)])
            self._mean.copy_(torch.from_numpy(mean))
            self._scale.copy_(torch.from_numpy(scale))
        if self._paid:
            scale = np.concatenate([np.tile(1.0 / m.std(), n) for m, n in zip(self._paid, counts, strict=True)])
            self._reward_scale.copy_(torch.from_numpy(scale))

    def observed(self, rows: Tensor) -> Tensor:
        """Return standardised observations [B, O]."""
        return (rows - self._mean).mul_(self._scale) if self._seen else rows

    def rewarded(self, rewards: Tensor) -> Tensor:
        """Return normalised rewards [B, agents]."""
        return rewards * self._reward_scale if self._paid else rewards

    def fold(self, flat: tuple[Float32, ...], hidden: int, *, out: bool) -> tuple[Float32, ...]:
        """Convert actors of standardised observations to actors of raw ones, or back if `out` is false."""
        if not self._seen:
            return flat
        folded = []
        for group, parameters, moments in zip(self._team.groups, flat, self._seen, strict=True):
            o, size = group.observation_size, group.observation_size * hidden
            result = parameters.astype(np.float64)
            w1, b1 = result[:, :size].reshape(-1, o, hidden), result[:, size : size + hidden]
            mean, std = moments.mean(), moments.std()
            if out:
                w1 /= std[:, None]
                b1 -= np.einsum("o,noh->nh", mean, w1)
            else:
                b1 += np.einsum("o,noh->nh", mean, w1)
                w1 *= std[:, None]
            folded.append(np.ascontiguousarray(result, np.float32))
        return tuple(folded)

    def tensors(self) -> dict[str, Tensor]:
        """Return the moments by name."""
        named = {f"observation_moments.{kind}": m.state for kind, m in enumerate(self._seen)}
        return named | {f"reward_moments.{kind}": m.state for kind, m in enumerate(self._paid)}
