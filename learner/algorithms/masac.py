"""MASAC: soft actor-critic (Haarnoja et al., 2018) with centralised twin critics for every agent, as in MADDPG.

The actor's head gives m and log s of a Gaussian; u = m + s n with standard normal n, a = tanh(u), and

    log pi(a) = sum_j [ -n_j^2 / 2 - log s_j - log(2 pi) / 2 - 2 (log 2 - u_j - softplus(-2 u_j)) ],

the last term being log(1 - tanh(u_j)^2). One update, for every agent i at once:

 1. a'_j sampled by the actors of all agents j,
    Y_i = reward_scale r_i + discount (1 - terminated) (min_k Q'_i,k(x', a') - alpha_i log pi_i(a'_i)), k = 1, 2.
 2. One Adam step of both critics on mean_B (Q_i,k(x, a) - Y_i)^2.
 3. One Adam step of each actor on mean_B (alpha_i log pi_i(a_i) - min_k Q_i,k(x, a_1 .., a_i, .. a_N)), a_i sampled and
    others' actions from the batch.
 4. One Adam step of log alpha_i on mean_B -alpha_i (log pi_i(a_i) + H), H = entropy_target times numbers in an action.
 5. Soft targets of the critics, with xi. There are no target actors.

Steps 1 and 3 use alpha_i from the start of the update.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import softplus

from common.actors import LOG_STD_RANGE
from common.config import AlgorithmConfig
from common.team import TeamSpec
from learner.algorithms.base import Algorithm, Batch, Diagnostics
from learner.networks.optimiser import Adam


class Sample(NamedTuple):
    """Actions drawn from the actors.

    Attributes:
        action: in the action layout.
        spread: s n, likewise.
        inside: 1 where log s lay within its range, else 0, likewise.
        log_probability: log pi [agents, B].
    """

    action: Tensor
    spread: Tensor
    inside: Tensor
    log_probability: Tensor


class Masac(Algorithm):
    """MASAC; see the module."""

    head = "gaussian"
    critics_each = 2
    climbed_each = 2
    noise_blocks = 2

    def __init__(self, config: AlgorithmConfig, team: TeamSpec, seed: int, like: Tensor, *, cores: int) -> None:
        super().__init__(config, team, seed, like, cores=cores)
        self.log_alpha = like.new_full((team.agents,), math.log(config.temperature))
        self._alpha_gradient = torch.zeros_like(self.log_alpha)
        self._alpha_adam = Adam(self.log_alpha, self._alpha_gradient, config.temperature_rate, cores=cores)
        sizes = [group.action_size for group in team.groups for _ in range(group.count)]
        self._entropy_target = like.new_tensor(sizes) * config.entropy_target
        width = torch.tensor(sizes).repeat_interleave(config.batch)
        row = torch.arange(width.shape[0]).repeat_interleave(width)
        first = torch.cumsum(width, 0) - width
        place = torch.arange(row.shape[0])
        mean = place + first[row]
        self._row, self._mean, self._deviation = (x.to(like.device) for x in (row, mean, mean + width[row]))
        self._upstream = like.new_zeros(2 * row.shape[0])

    def tensors(self) -> dict[str, Tensor]:
        """See `Algorithm`."""
        adam = self._alpha_adam
        own = {"log_alpha": self.log_alpha, "alpha_mean": adam.mean, "alpha_square": adam.square}
        return {**super().tensors(), **own, "alpha_steps": adam.steps}

    def update(self, batch: Batch, noise: Tensor, phase: int, *, diagnostics: bool) -> Diagnostics | None:
        """See `Algorithm`."""
        self.observe(batch)
        alpha = self.log_alpha.exp()[:, None]
        following = self._sample(self.next.actor, noise[0])
        self.next.decide(following.action)
        value = self.critics.forward(self.target_views, self.next)
        soft = torch.minimum(value[0], value[1]) - alpha * following.log_probability
        target = self.bootstrapped(batch, soft)
        error = self.regress(target)[0]
        self.critic_adam.step(self.target_phi, self.config.target_rate)
        sample = self._sample(self.current.actor, noise[1])
        climbed = self._climb(sample, alpha)
        if self.config.temperature_rate > 0.0:
            surprise = sample.log_probability.mean(dim=1) + self._entropy_target
            torch.mul(alpha[:, 0], surprise, out=self._alpha_gradient).neg_()
            self._alpha_adam.step()
        if not diagnostics:
            return None
        reported = self.diagnosed(error, climbed, target)
        density = sample.log_probability.mean(dim=1)
        return reported._replace(temperature=alpha[:, 0], log_probability=density, soft=True)

    def _sample(self, inputs: list[Tensor], noise: Tensor) -> Sample:
        output = self.actors.forward(inputs)
        raw = output.index_select(0, self._deviation)
        log_deviation = raw.clamp(*LOG_STD_RANGE)
        spread = log_deviation.exp() * noise
        before = output.index_select(0, self._mean) + spread
        correction = 2.0 * (math.log(2.0) - before - softplus(-2.0 * before))
        density = noise.square() * -0.5 - log_deviation - correction - 0.5 * math.log(2.0 * math.pi)
        rows = self.team.agents * self.config.batch
        total = density.new_zeros(rows).index_add_(0, self._row, density)
        inside = (raw == log_deviation).to(raw.dtype)
        return Sample(before.tanh_(), spread, inside, total.view(-1, self.config.batch))

    def _climb(self, sample: Sample, alpha: Tensor) -> Tensor:
        """Take the actors' step; return what they climb, min_k Q - alpha log pi."""
        batch = self.config.batch
        torch.sub(sample.action, self.current.acted, out=self.change)
        value = self.appraise(sample.action)
        climbed = torch.minimum(value[0], value[1]) - alpha * sample.log_probability
        first = (value[0] <= value[1]).to(value.dtype)
        torch.mul(first, -1.0 / batch, out=value[0])
        torch.mul(1.0 - first, -1.0 / batch, out=value[1])
        self.slope(value)
        action = sample.action
        weight = (alpha / batch).expand(-1, batch).reshape(-1).index_select(0, self._row)
        by_sum = torch.addcmul(self.slopes, self.slopes * action, action, value=-1.0) + 2.0 * weight * action
        by_deviation = (by_sum * sample.spread - weight) * sample.inside
        self._upstream.index_copy_(0, self._mean, by_sum).index_copy_(0, self._deviation, by_deviation)
        self.actors.descend(self.current.actor, self._upstream)
        return climbed
