"""PPO (Schulman et al. 2017) for every type of agent: networks, and the losses of actors and value functions.

    ratio   = pi(a | o) / pi_old(a | o)            pi_old by the objective, see `eia_sec.learner.on_policy.updates`
    L_actor = -mean(min(ratio A, clip(ratio, 1 - c, 1 + c) A)) - w_H mean(H(pi(. | o)))
    L_value = mean((V - R)^2)

An algorithm on policy is a subclass in a file of its own: it names its value functions, and overrides a loss where it
has another.
"""

from abc import ABC, abstractmethod
from typing import Final, NamedTuple

import torch
from torch import Tensor

from eia_sec.common.config import OnPolicyConfig
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.learner.on_policy.experience import split_actions
from eia_sec.learner.on_policy.minibatch import Minibatch
from eia_sec.learner.on_policy.policies import Policies
from eia_sec.learner.on_policy.values import GroupValue

MOST_LOG_RATIO: Final = 20.0
"""Largest logarithm of the ratio of two policies; exp of 89 is more than a 32-bit number holds."""


class ActorLoss(NamedTuple):
    """The loss of a type's actors on a minibatch, and what it measured.

    Attributes:
        loss: L_actor.
        entropy: mean entropy, nats.
        kl: estimate of KL(pi_old || pi), mean(ratio - 1 - ln ratio).
        clipped: share of samples whose ratio is clipped.
    """

    loss: Tensor
    entropy: Tensor
    kl: Tensor
    clipped: Tensor


class Ppo(ABC):
    """The networks of an algorithm on policy, and its losses.

    Args:
        config: the algorithm's configuration.
        team: the layout of the team.
        seed: seed of the run, from which every initialisation follows.
        device: torch device.

    Attributes:
        policies: the actors.
        values: the value functions of each type, GroupValue modules.
    """

    def __init__(self, config: OnPolicyConfig, team: TeamSpec, seed: int, device: str) -> None:
        self.config, self.team = config, team
        self.policies = Policies(config, team, seed).to(device)
        self.values: list[GroupValue] = [self.value_function(group, seed).to(device) for group in team.groups]
        self._scales = config.entropy_scales

    @abstractmethod
    def value_function(self, group: GroupSpec, seed: int) -> GroupValue:
        """Return fresh value functions of a type's agents."""

    def shared_name(self, name: str) -> str:
        """Return the name of the shared tensor that a tensor of separate networks begins as.

        Args:
            name: as in `eia_sec.learner.on_policy.updates.Updates.network_tensors`.
        """
        return name

    def surrogate(self, ratio: Tensor, advantage: Tensor) -> Tensor:
        """Return what actors maximise besides their entropy, of each sample [B, n].

        Args:
            ratio: pi(a | o) / pi_old(a | o), [B, n].
            advantage: A, [B, n].
        """
        clip = self.config.clip
        return torch.minimum(ratio * advantage, ratio.clamp(1.0 - clip, 1.0 + clip) * advantage)

    def actor_loss(self, kind: int, batch: Minibatch) -> ActorLoss:
        """Return the loss of a type's actors on a minibatch."""
        agents, config = self.team.agent_slices()[kind], self.config
        log_probability, advantage = (batch.tensors[name][:, agents] for name in ("log_probability", "advantage"))
        action = split_actions(self.team, batch.tensors["action"])[kind]
        sequences = None if batch.sequences is None else batch.sequences[kind][0]
        policy = self.policies.evaluate(kind, batch.own(kind), action, sequences)
        # Beyond this the ratio overflows, and one sample would make every weight a NaN; its gradient is clipped anyway.
        log_ratio = (policy.log_probability - log_probability).clamp(max=MOST_LOG_RATIO)
        ratio, clip = log_ratio.exp(), config.clip
        surrogate = self.surrogate(ratio, advantage)
        entropy = policy.entropy.mean()
        weight = batch.entropy_weight * self._scales.get(self.team.groups[kind].name, 1.0)
        loss = -surrogate.mean() - weight * entropy
        with torch.no_grad():
            kl = (ratio - 1.0 - log_ratio).mean()
            clipped = ((ratio - 1.0).abs() > clip).float().mean()
        return ActorLoss(loss, entropy.detach(), kl, clipped)

    def value_loss(self, kind: int, batch: Minibatch) -> Tensor:
        """Return the loss of a type's value functions on a minibatch."""
        returns = batch.tensors["returns"][:, self.team.agent_slices()[kind]]
        sequences = None if batch.sequences is None else batch.sequences[kind][1]
        return self.values[kind].loss(batch.team, batch.own(kind), returns, sequences)
