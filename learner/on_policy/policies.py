"""The actors of all types."""

from collections.abc import Sequence

from torch import Tensor, nn

from eia_sec.common.actors import Head, TeamActors, actor_outputs
from eia_sec.common.config import OnPolicyConfig
from eia_sec.common.team import Float32, GroupSpec, TeamSpec
from eia_sec.learner.networks.recurrent import make_stack
from eia_sec.learner.networks.sequences import Sequences
from eia_sec.learner.networks.stack import Stack
from eia_sec.learner.on_policy.distributions import Evaluated, evaluate
from eia_sec.learner.on_policy.normalisation import Scales
from eia_sec.learner.on_policy.preferences import FOLLOW, prefer

HEAD: Head = "gaussian"
"""Head of types with continuous actions."""
LAST_GAIN = 0.01
"""Gain of the actors' last layer, so that a fresh policy is nearly uniform but for `learner.on_policy.preferences`."""


class Policies(nn.Module):
    """All actors.

    Args:
        config: the algorithm's configuration.
        team: the layout of the team.
        seed: seed of the run.

    Attributes:
        stacks: the networks of each type.
        scales: what their inputs are scaled by; None where they read observations as they are.
    """

    def __init__(self, config: OnPolicyConfig, team: TeamSpec, seed: int) -> None:
        super().__init__()
        self._config, self._team = config, team
        self.stacks = [self._stack(group, seed) for group in team.groups]
        self.types = nn.ModuleList(self.stacks)
        self.scales: Scales | None = None

    def _stack(self, group: GroupSpec, seed: int) -> Stack:
        config = self._config
        count = 1 if config.shared else group.count
        names = [(seed, "actor", group.name, 0)] * count
        stack = make_stack(config, count, group.seen, actor_outputs(group, HEAD), LAST_GAIN, names)
        if config.module is None:
            prefer(stack, group, config.suggestion_logits.get(group.name, FOLLOW))
        return stack

    def evaluate(self, kind: int, observation: Tensor, action: Tensor, sequences: Sequences | None = None) -> Evaluated:
        """Return the log-probability and the entropy of a type's present policy.

        Args:
            kind: index of the type.
            observation: [B, n, o].
            action: [B, n, a].
            sequences: how the rows follow one another, for actors with memory.
        """
        return evaluate(self._team.groups[kind], observation, self.stacks[kind](observation, sequences), action)

    def actors(self) -> TeamActors:
        """Return a copy of all actors, which read observations as they are."""
        flat = tuple(self._published(stack, kind) for kind, stack in enumerate(self.stacks))
        return TeamActors(self._team, self._config.hidden, flat, HEAD, self._config.memory, self._config.module)

    def load(self, flat: Sequence[Float32]) -> None:
        """Replace the actors' parameters by those of actors as `actors` returns them, [n_v or 1, P_v] for each type."""
        for kind, (stack, parameters) in enumerate(zip(self.stacks, flat, strict=True)):
            stack.load(parameters)
            if self.scales is not None:
                shift, scale = self.scales.of_type(kind)
                stack.rescale_inputs(shift, scale)
        if self.scales is not None and self.scales.fresh:
            self.scales.loaded.fill_(1.0)

    def _published(self, stack: Stack, kind: int) -> Float32:
        """Return a copy of a type's parameters, as those of networks that read observations as they are."""
        if self.scales is None:
            return stack.export()
        shift, scale = self.scales.of_type(kind)
        flat = stack.flat.detach().clone()
        stack.rescale_inputs(-shift / scale, 1.0 / scale, flat)
        return stack.export(flat)
