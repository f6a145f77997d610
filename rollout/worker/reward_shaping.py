"""What a worker's rows pay where the reward of a farm pays the change of a level: relays, for D_c (W1).

The positioning part of r_c adds up over an episode to what D_c was at the start less what it is at the end, so that how
well a relay stands in between is worth nothing, and at a discount below 1 closing in at once is worth more than the
energy it takes. With Phi = +alpha_1 D_c t_step as a potential (Ng et al. 1999), a row pays

    r + gamma_s Phi(k) - Phi(k-1)

instead, in which the changes of D_c cancel and -(1 - gamma_s) alpha_1 D_c(k) t_step is left: what standing so far away
costs in this step. At gamma_s = gamma that leaves the best policy what it is; elsewhere it asks for another one. It is
what learners are taught, and nothing else: episodes are summed up, policies evaluated and elites chosen by r.
"""

from common.team import Float32
from rollout.envs.base import Environments


class RewardShaping:
    """Follows a batch of environments from step to step.

    Args:
        environments: the batch.
        discount: gamma_s; 0 leaves rewards as they are.
    """

    def __init__(self, environments: Environments, discount: float) -> None:
        self._environments = environments
        self._discount = discount
        self._before = environments.potential.copy()

    def before_step(self) -> None:
        """Note Phi before a step."""
        if self._discount:
            self._before = self._environments.potential.copy()

    def shaped_reward(self) -> Float32:
        """Return what rows pay for the last step, [E, agents]."""
        environments = self._environments
        if not self._discount:
            return environments.reward
        # The environments' potential is -Phi.
        shaped: Float32 = environments.reward + self._before - self._discount * environments.potential
        return shaped
