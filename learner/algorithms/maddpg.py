"""MADDPG (Lowe et al., 2017, Multi-agent actor-critic for mixed cooperative-competitive environments).

One update, for every agent i at once, with x all observations and a all actions in the joint scope:

 1. a'_j = mu'_j(o'_j) by the target actors of all agents j,
    Y_i = reward_scale r_i + discount (1 - terminated) Q'_i(x', a'_1 .. a'_N).
 2. One Adam step of each critic on mean_B (Q_i(x, a) - Y_i)^2.
 3. One Adam step of each actor on -mean_B Q_i(x, a_1 .., mu_i(o_i), .. a_N), others' actions from the batch.
 4. Soft targets of critics and actors, with xi.
"""

from torch import Tensor

from learner.algorithms.base import Algorithm, Batch, Diagnostics


class Maddpg(Algorithm):
    """MADDPG; see the module."""

    def has_target_actors(self) -> bool:
        """See `Algorithm`."""
        return True

    def update(self, batch: Batch, noise: Tensor, phase: int, *, diagnostics: bool) -> Diagnostics | None:
        """See `Algorithm`."""
        self.observe(batch)
        self.next.decide(self.actors.forward(self.next.actor, next_action=True).tanh_())
        target = self.bootstrapped(batch, self.critics.forward(self.target_views, self.next)[0])
        error = self.regress(target)[0]
        self.critic_adam.step(self.target_phi, self.config.target_rate)
        action = self.choose()
        value = self.appraise(action)
        climbed = value[0].clone() if diagnostics else None
        value.fill_(-1.0 / self.config.batch)
        self.slope(value)
        self.climb(action)
        return self.diagnosed(error, climbed, target) if climbed is not None else None
