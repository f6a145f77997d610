"""The actors of all agents on the learner's side.

A deterministic head outputs the inverse hyperbolic tangent of the action. A Gaussian head outputs its mean and, behind
it, the logarithm of its standard deviation. With discrete actions there is one output for each option
(see `eia_sec.common.actors`).
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from eia_sec.common.actors import Head, TeamActors, actor_outputs
from eia_sec.common.config import OffPolicyConfig
from eia_sec.common.team import Float32, TeamSpec
from eia_sec.learner.networks.stacks import Shape, Stacks
from eia_sec.learner.off_policy.inputs import Inputs
from eia_sec.learner.off_policy.trained import Trained


class Actors(Trained):
    """All actors and, where wanted, target actors.

    They are drawn once for each type (A4).

    Args:
        config: the algorithm's configuration.
        team: the layout of the team.
        seed: seed of the run.
        like: a tensor of the wanted device and type.
        head: kind of the last layer.
        shared: whether the agents of a type share one actor, whose data are the rows of all of them.
        target: whether there are target actors.
        cores: processor cores for the compiled kernels; 0 to compute by torch.
    """

    def __init__(
        self,
        config: OffPolicyConfig,
        team: TeamSpec,
        seed: int,
        like: Tensor,
        *,
        head: Head,
        shared: bool,
        target: bool,
        cores: int,
    ) -> None:
        self._shared, self._counts = shared, [group.count for group in team.groups]
        rows = [(1, g.count * config.batch) if shared else (g.count, config.batch) for g in team.groups]
        sizes = [(g.observation_size, actor_outputs(g, head)) for g in team.groups]
        shapes = [Shape(n, *size, each) for (n, each), size in zip(rows, sizes, strict=True)]
        networks = Stacks(shapes, config.hidden, like, cores=cores)
        drawn = TeamActors.initial(team, config.hidden, seed, head=head, shared=shared)
        for stack, parameters in zip(networks.stacks, drawn.flat, strict=True):
            stack.load(parameters)
        super().__init__(networks, config.actor_rate, config.gradient_clip, target=target)

    def load(self, flat: Sequence[Float32]) -> None:
        """Replace the actors' parameters, [n_v or 1, P_v] for each type in the order of `eia_sec.common.actors`."""
        for stack, parameters in zip(self.networks.stacks, flat, strict=True):
            stack.load(parameters)

    def export(self) -> tuple[Float32, ...]:
        """Return a copy of each type's parameters [n_v or 1, P_v], in the order of `eia_sec.common.actors`."""
        return tuple(stack.export().astype(np.float32) for stack in self.networks.stacks)

    def outputs(self, inputs: Inputs) -> Tensor:
        """Return the heads' outputs, before any tanh, flat: type by type, agent by agent, row by row."""
        output: Tensor = self.networks(self._seen(inputs))
        return output

    def target_outputs(self, inputs: Inputs) -> Tensor:
        """Return what `outputs` does, of the target actors, or of the actors where there are none."""
        output: Tensor = self.target(self._seen(inputs))
        return output

    def _seen(self, inputs: Inputs) -> list[Tensor]:
        return [x.flatten(0, 1)[None] for x in inputs.actor] if self._shared else inputs.actor

    def norms_by_agent(self) -> Tensor:
        """Return `norms` of each agent's actor [agents]."""
        if not self._shared:
            return self.norms
        return torch.cat([norm.expand(count) for norm, count in zip(self.norms, self._counts, strict=True)])

    def actions(self, inputs: Inputs) -> Tensor:
        """Return a = pi(o) of deterministic actors, in the action layout."""
        return torch.tanh(self.outputs(inputs))

    def next_actions(self, inputs: Inputs) -> Tensor:
        """Return a' = pi'(o') in the action layout: of the target actors, or of the actors where there are none."""
        return torch.tanh(self.target_outputs(inputs))
