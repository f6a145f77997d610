"""A loss on policy and a loss off policy."""

import torch

from eia_sec.learner.off_policy.maddpg import Maddpg
from eia_sec.learner.on_policy.ippo import Ippo


class Smooth(Ippo):
    """PPO with a penalty in place of the clip."""

    def surrogate(self, ratio, advantage):
        return ratio * advantage - self.config.penalty * (ratio - 1.0).square()


class Bold(Maddpg):
    """MADDPG whose critics forgive what turned out better than they thought."""

    def critic_loss(self, q, target):
        weight = torch.where(target > q, self.config.optimism, 1.0)
        return (weight * (q - target).square()).mean(dim=-1).sum()
