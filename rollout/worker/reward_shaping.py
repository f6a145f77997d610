"""Potential-based reward shaping of the relays' reward, which is the change of a level, D_c (W1).

Over an episode, the positioning part of r_c adds up to D_c at the start minus D_c at the end. Where a relay is in
between earns nothing, and at a discount below 1 closing in at once is worth more than the energy it takes. With the
potential Phi = +alpha_1 D_c t_step (Ng et al. 1999; `FarmBatch.potential`), a worker's rows hold the shaped reward

    r' = r + gamma_s Phi(k) - Phi(k-1)

in which the changes of D_c cancel and -(1 - gamma_s) alpha_1 D_c(k) t_step is left: the cost of being so far away in
this step. At gamma_s = gamma the best policy stays the same; at another gamma_s it may differ. Only the rows that
learners train on are shaped. Episode returns and evaluations use r, and so do elite scores with `elite.farms`; scores
from training use r'.

A learner for which the time limit is terminal needs Phi = 0 after the last step. At gamma_s = 1 nothing is left of the
positioning part then but -alpha_1 D_c t_step in the last step: where a relay ends is all that counts, and it is paid
when it counts.
"""

import numpy as np

from eia_sec.common.team import Float32
from eia_sec.rollout.envs.base import Environments


class RewardShaping:
    """Shapes the rewards of a batch of environments.

    Args:
        environments: the batch.
        discount: gamma_s; 0 turns shaping off.
        ends: whether the potential is 0 once an episode is over.
    """

    def __init__(self, environments: Environments, discount: float, *, ends: bool = False) -> None:
        self._environments = environments
        self._discount, self._ends = discount, ends
        self._before = environments.potential.copy()

    def before_step(self) -> None:
        """Keep Phi before a step."""
        if self._discount:
            self._before = self._environments.potential.copy()

    def shaped_reward(self) -> Float32:
        """Return r' of the last step, [E, agents]."""
        environments = self._environments
        if not self._discount:
            return environments.reward
        after = environments.potential
        if self._ends:
            after = np.where(environments.ended[:, None], np.float32(0), after)
        shaped: Float32 = environments.reward - self._before + self._discount * after
        return shaped
