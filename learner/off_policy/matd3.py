"""MATD3 (Ackermann et al., 2019, Reducing overestimation bias in multi-agent domains using double centralized critics).

MADDPG with the three changes of TD3. One update, for every agent i at once:

 1. Targets, with smoothed next actions of all agents j and the lesser of two target critics, k = 1, 2:
        a'_j = clip(mu'_j(o'_j) + clip(smoothing_noise n, -smoothing_clip, smoothing_clip), -1, 1)
        Y_i = reward_scale r_i + discount (1 - terminated) min_k Q'_i,k(x', a')
 2. Critic loss sum_k mean_B (Q_i,k(x, a) - Y_i)^2, and one Adam step of both critics.
 3. In every `actor_delay`-th update, actor loss -mean_B Q_i,1(x, a_1 .., mu_i(o_i), .. a_N), and one Adam step of each
    actor.
 4. In the same updates soft targets, with xi, of critics and actors.
"""

import torch
from torch import Tensor

from eia_sec.common.config import Matd3Config
from eia_sec.learner.off_policy.algorithm import ActorCritic, Batch, Diagnostics


class Matd3(ActorCritic[Matd3Config]):
    """MATD3; the module gives its equations."""

    critics_each = 2
    noise_blocks = 1

    def has_target_actors(self) -> bool:
        """See `Algorithm`."""
        return True

    @classmethod
    def actor_period(cls, config: Matd3Config) -> int:
        """See `Algorithm`."""
        return config.actor_delay

    def update(self, batch: Batch, noise: Tensor, *, actor_step: bool, diagnostics: bool) -> Diagnostics | None:
        """See `Algorithm`."""
        config = self.config
        inputs, next_inputs = self.inputs(batch)

        # 1. Targets
        with torch.no_grad():
            smoothing = (noise[0] * config.smoothing_noise).clamp_(-config.smoothing_clip, config.smoothing_clip)
            next_inputs.with_actions(self.actors.next_actions(next_inputs).add_(smoothing).clamp_(-1.0, 1.0))
            next_q = self.critics.target_values(next_inputs)
            target = self.td_target(batch, torch.minimum(next_q[0], next_q[1]))

        # 2. and 4. Critic loss, critic step, target critics
        q = self.critics(inputs)
        critic_loss = self.critic_loss(q, target)
        self.critics.zero_grad()
        critic_loss.backward()
        self.critics.step(norms=diagnostics)
        if actor_step:
            self.critics.follow(config.target_rate)
        if not (actor_step or diagnostics):
            return None

        # 3. and 4. Actor loss, actor step, target actors
        (objective,) = self.critics.of_policies(inputs, self.actors.actions(inputs))
        if actor_step:
            actor_loss = -objective.mean(dim=1).sum()
            self.actors.zero_grad()
            actor_loss.backward()
            self.actors.step(norms=diagnostics)
            self.actors.follow(config.target_rate)

        return self.measured(q[0], objective, target) if diagnostics else None
