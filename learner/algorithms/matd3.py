"""MATD3 (Ackermann et al., 2019, Reducing overestimation bias in multi-agent domains using double centralized critics).

MADDPG with the three changes of TD3. One update, for every agent i at once:

 1. a'_j = clip(mu'_j(o'_j) + clip(smoothing_noise n, -smoothing_clip, smoothing_clip), -1, 1) for all agents j,
    Y_i = reward_scale r_i + discount (1 - terminated) min_k Q'_i,k(x', a'), k = 1, 2.
 2. One Adam step of both critics on mean_B (Q_i,k(x, a) - Y_i)^2.
 3. In every `actor_delay`-th update one Adam step of each actor on -mean_B Q_i,1(x, a_1 .., mu_i(o_i), .. a_N), and
    soft targets of critics and actors, with xi.
"""

import torch
from torch import Tensor

from common.config import AlgorithmConfig
from learner.algorithms.base import Algorithm, Batch, Diagnostics


class Matd3(Algorithm):
    """MATD3; see the module."""

    critics_each = 2
    noise_blocks = 1

    def has_target_actors(self) -> bool:
        """See `Algorithm`."""
        return True

    @classmethod
    def phases(cls, config: AlgorithmConfig) -> int:
        """See `Algorithm`."""
        return config.actor_delay

    def phase(self, number: int) -> int:
        """Return 0 in updates with a step of the actors."""
        return (number + 1) % self.phases(self.config)

    def update(self, batch: Batch, noise: Tensor, phase: int, *, diagnostics: bool) -> Diagnostics | None:
        """See `Algorithm`."""
        config = self.config
        self.observe(batch)
        smooth = (noise[0] * config.smoothing_noise).clamp_(-config.smoothing_clip, config.smoothing_clip)
        action = self.actors.forward(self.next.actor, next_action=True).tanh_().add_(smooth).clamp_(-1.0, 1.0)
        self.next.decide(action)
        value = self.critics.forward(self.target_views, self.next)
        target = self.bootstrapped(batch, torch.minimum(value[0], value[1]))
        error = self.regress(target)[0]
        if phase:
            self.critic_adam.step()
        else:
            self.critic_adam.step(self.target_phi, config.target_rate)
        if phase and not diagnostics:
            return None
        action = self.choose()
        value = self.appraise(action)
        climbed = value[0].clone() if diagnostics else None
        if not phase:
            value.fill_(-1.0 / config.batch)
            self.slope(value)
            self.climb(action)
        return self.diagnosed(error, climbed, target) if climbed is not None else None
