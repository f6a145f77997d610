"""MADDPG (Lowe et al., 2017, Multi-agent actor-critic for mixed cooperative-competitive environments).

One update, for every agent i at once, with x all observations and a all actions in the joint scope:

 1. Targets, with the next actions a'_j = mu'_j(o'_j) by the target actors of all agents j:
        Y_i = reward_scale r_i + discount (1 - terminated) Q'_i(x', a'_1 .. a'_N)
 2. Critic loss mean_B (Q_i(x, a) - Y_i)^2, and one Adam step of each critic.
 3. Actor loss -mean_B Q_i(x, a_1 .., mu_i(o_i), .. a_N), with the others' actions from the batch, and one Adam step of
    each actor.
 4. Soft targets: phi' <- xi phi + (1 - xi) phi', and theta' likewise. Each follows its optimiser step in the same
    sweep.
"""

import torch
from torch import Tensor

from eia_sec.common.config import MaddpgConfig
from eia_sec.learner.off_policy.algorithm import Algorithm, Batch, Diagnostics


class Maddpg(Algorithm[MaddpgConfig]):
    """MADDPG; the module gives its equations."""

    def has_target_actors(self) -> bool:
        """See `Algorithm`."""
        return True

    def update(self, batch: Batch, noise: Tensor, *, actor_step: bool, diagnostics: bool) -> Diagnostics | None:
        """See `Algorithm`."""
        config = self.config
        inputs, next_inputs = self.inputs(batch)

        # 1. Targets
        next_actions = self.actors.next_actions(next_inputs)
        next_q = self.critics.q_values(self._target_parameters, next_inputs.with_actions(next_actions))
        target = self.td_target(batch, next_q.values[0])

        # 2. and 4. Critic loss, critic step, target critics
        td_error, gradient = self.critic_gradient(inputs, target)
        self.critic_adam.step(gradient, self.target_phi, config.target_rate)

        # 3. and 4. Actor loss, actor step, target actors
        policy = self.actors.policy_actions(inputs)
        q = self.objective_q_values(inputs, policy.actions)
        grad_wrt_q = torch.full_like(q.values, -1.0 / config.batch)
        self.actors.step(policy, self.action_gradient(q, grad_wrt_q))

        return self.measured(td_error[0], q.values[0], target) if diagnostics else None
