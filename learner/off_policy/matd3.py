"""MATD3 (Ackermann et al., 2019, Reducing overestimation bias in multi-agent domains using double centralized critics).

MADDPG with the three changes of TD3. One update, for every agent i at once:

 1. Targets, with smoothed next actions of all agents j and the lesser of two target critics, k = 1, 2:
        a'_j = clip(mu'_j(o'_j) + clip(smoothing_noise n, -smoothing_clip, smoothing_clip), -1, 1)
        Y_i = reward_scale r_i + discount (1 - terminated) min_k Q'_i,k(x', a')
 2. Critic loss sum_k mean_B (Q_i,k(x, a) - Y_i)^2, and one Adam step of both critics.
 3. In every `actor_delay`-th update, actor loss -mean_B Q_i,1(x, a_1 .., mu_i(o_i), .. a_N), and one Adam step of each
    actor.
 4. In the same updates soft targets, with xi, of critics and actors. Each follows its optimiser step in the same sweep.
"""

import torch
from torch import Tensor

from eia_sec.common.config import Matd3Config
from eia_sec.learner.off_policy.algorithm import Algorithm, Batch, Diagnostics


class Matd3(Algorithm[Matd3Config]):
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
        smoothing = (noise[0] * config.smoothing_noise).clamp_(-config.smoothing_clip, config.smoothing_clip)
        next_actions = self.actors.next_actions(next_inputs).add_(smoothing).clamp_(-1.0, 1.0)
        next_q = self.critics.q_values(self._target_parameters, next_inputs.with_actions(next_actions))
        target = self.td_target(batch, torch.minimum(next_q.values[0], next_q.values[1]))

        # 2. and 4. Critic loss, critic step, target critics
        td_error, gradient = self.critic_gradient(inputs, target)
        self.critic_adam.step(gradient, self.target_phi if actor_step else None, config.target_rate)
        if not (actor_step or diagnostics):
            return None

        # 3. and 4. Actor loss, actor step, target actors
        policy = self.actors.policy_actions(inputs)
        q = self.objective_q_values(inputs, policy.actions)
        if actor_step:
            grad_wrt_q = torch.full_like(q.values, -1.0 / config.batch)
            self.actors.step(policy, self.action_gradient(q, grad_wrt_q))

        return self.measured(td_error[0], q.values[0], target) if diagnostics else None
