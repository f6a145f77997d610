"""MADDPG (Lowe et al., 2017, Multi-agent actor-critic for mixed cooperative-competitive environments).

One update, for every agent i at once, with x all observations and a all actions in the joint scope:

 1. Targets, with the next actions a'_j = mu'_j(o'_j) by the target actors of all agents j:
        Y_i = reward_scale r_i + discount (1 - terminated) Q'_i(x', a'_1 .. a'_N)
 2. Critic loss mean_B (Q_i(x, a) - Y_i)^2, and one Adam step of each critic.
 3. Actor loss -mean_B Q_i(x, a_1 .., mu_i(o_i), .. a_N), with the others' actions from the batch, and one Adam step of
    each actor.
 4. Soft targets: phi' <- xi phi + (1 - xi) phi', and theta' likewise.
"""

import torch
from torch import Tensor

from eia_sec.common.config import MaddpgConfig
from eia_sec.learner.off_policy.algorithm import ActorCritic, Batch, Diagnostics


class Maddpg(ActorCritic[MaddpgConfig]):
    """MADDPG; the module gives its equations."""

    def has_target_actors(self) -> bool:
        """See `Algorithm`."""
        return True

    def update(self, batch: Batch, noise: Tensor, *, actor_step: bool, diagnostics: bool) -> Diagnostics | None:
        """See `Algorithm`."""
        inputs, next_inputs = self.inputs(batch)

        # 1. Targets
        with torch.no_grad():
            next_inputs.with_actions(self.actors.next_actions(next_inputs))
            (next_q,) = self.critics.target_values(next_inputs)
            target = self.td_target(batch, next_q)

        # 2. and 4. Critic loss, critic step, target critics
        (q,) = self.critics(inputs)
        critic_loss = self.critic_loss(q, target)
        self.critics.zero_grad()
        critic_loss.backward()
        self.critics.step(norms=diagnostics)
        self.critics.follow(self.config.target_rate)

        # 3. and 4. Actor loss, actor step, target actors
        (objective,) = self.critics.of_policies(inputs, self.actors.actions(inputs))
        actor_loss = -objective.mean(dim=1).sum()
        self.actors.zero_grad()
        actor_loss.backward()
        self.actors.step(norms=diagnostics)
        self.actors.follow(self.config.target_rate)

        return self.measured(q, objective, target) if diagnostics else None
