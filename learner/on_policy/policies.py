"""The actors of all types, and PPO's loss for them (Schulman et al. 2017).

ratio   = pi(a | o) / pi_old(a | o)                pi_old by the objective, see `eia_sec.learner.on_policy.updates`
L_actor = -mean(min(ratio A, clip(ratio, 1 - c, 1 + c) A)) - w_H mean(H(pi(. | o)))
"""

from collections.abc import Sequence
from typing import Final, NamedTuple

import torch
from torch import Tensor, nn

from eia_sec.common.actors import Head, TeamActors, actor_outputs
from eia_sec.common.config import OnPolicyConfig
from eia_sec.common.team import Float32, GroupSpec, TeamSpec
from eia_sec.learner.on_policy.distributions import evaluate
from eia_sec.learner.on_policy.networks import Stack
from eia_sec.learner.on_policy.preferences import FOLLOW, prefer
from eia_sec.learner.on_policy.recurrent import make_stack
from eia_sec.learner.on_policy.sequences import Sequences

MOST_LOG_RATIO: Final = 20.0
"""Largest logarithm of the ratio of two policies; exp of 89 is more than a 32-bit number holds."""

HEAD: Head = "gaussian"
"""Head of types with continuous actions."""
LAST_GAIN = 0.01
"""Gain of the actors' last layer, so that a fresh policy is nearly uniform but for `learner.on_policy.preferences`."""


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


class Policies(nn.Module):
    """All actors.

    Args:
        config: the algorithm's configuration.
        team: the layout of the team.
        seed: seed of the run.

    Attributes:
        stacks: the networks of each type.
    """

    def __init__(self, config: OnPolicyConfig, team: TeamSpec, seed: int) -> None:
        super().__init__()
        self._config, self._team = config, team
        self.stacks = [self._stack(group, seed) for group in team.groups]
        self.types = nn.ModuleList(self.stacks)

    def _stack(self, group: GroupSpec, seed: int) -> Stack:
        config = self._config
        count = 1 if config.parameters == "shared" else group.count
        names = initialisation_names("actor", group, count, seed, per_type=config.initialisation == "type")
        stack = make_stack(config, count, group.observation_size, actor_outputs(group, HEAD), LAST_GAIN, names)
        prefer(stack, group, config.type_suggestion_logits().get(group.name, FOLLOW))
        return stack

    def loss(
        self,
        kind: int,
        observation: Tensor,
        action: Tensor,
        log_probability: Tensor,
        advantage: Tensor,
        entropy_weight: float | Tensor,
        sequences: Sequences | None = None,
    ) -> ActorLoss:
        """Return the loss of a type on a minibatch.

        Args:
            kind: index of the type.
            observation: [B, n, o].
            action: [B, n, a].
            log_probability: [B, n] under the policy that the ratio is taken against.
            advantage: [B, n], normalised.
            entropy_weight: w_H.
            sequences: how the rows follow one another, for actors with memory.
        """
        group = self._team.groups[kind]
        policy = evaluate(group, observation, self.stacks[kind](observation, sequences), action)
        # Beyond this the ratio overflows, and one sample would make every weight a NaN; its gradient is clipped anyway.
        log_ratio = (policy.log_probability - log_probability).clamp(max=MOST_LOG_RATIO)
        ratio, clip = log_ratio.exp(), self._config.clip
        surrogate = torch.minimum(ratio * advantage, ratio.clamp(1.0 - clip, 1.0 + clip) * advantage)
        entropy = policy.entropy.mean()
        loss = -surrogate.mean() - entropy_weight * entropy
        with torch.no_grad():
            kl = (ratio - 1.0 - log_ratio).mean()
            clipped = ((ratio - 1.0).abs() > clip).float().mean()
        return ActorLoss(loss, entropy.detach(), kl, clipped)

    def log_probability(
        self, kind: int, observation: Tensor, action: Tensor, sequences: Sequences | None = None
    ) -> Tensor:
        """Return log pi(a | o) [B, n] of a type's actions; arguments as for `loss`."""
        outputs = self.stacks[kind](observation, sequences)
        return evaluate(self._team.groups[kind], observation, outputs, action).log_probability

    def actors(self) -> TeamActors:
        """Return a copy of all actors."""
        flat = tuple(stack.export() for stack in self.stacks)
        return TeamActors(self._team, self._config.hidden, flat, HEAD, self._config.memory)

    def load(self, flat: Sequence[Float32]) -> None:
        """Replace the actors' parameters, [n_v or 1, P_v] for each type."""
        for stack, parameters in zip(self.stacks, flat, strict=True):
            stack.load(parameters)


def initialisation_names(
    what: str, group: GroupSpec, count: int, seed: int, *, per_type: bool
) -> list[tuple[int | str, ...]]:
    """Return the names of the random streams of `count` networks: one stream for the type, or one for each agent."""
    return [(seed, what, group.name, 0 if per_type else index) for index in range(count)]
