"""The actors of all agents on the learner's side.

A deterministic head outputs the inverse hyperbolic tangent of the action. A Gaussian head outputs its mean and, behind
it, the logarithm of its standard deviation (see `eia_sec.common.actors`).
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from eia_sec.common.actors import Head, TeamActors
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
        target: whether there are target actors.
        cores: processor cores for the compiled kernels; 0 to compute by torch.
    """

    def __init__(
        self, config: OffPolicyConfig, team: TeamSpec, seed: int, like: Tensor, *, head: Head, target: bool, cores: int
    ) -> None:
        outputs = 2 if head == "gaussian" else 1
        shapes = [Shape(g.count, g.observation_size, outputs * g.action_size, config.batch) for g in team.groups]
        networks = Stacks(shapes, config.hidden, like, cores=cores)
        drawn = TeamActors.initial(team, config.hidden, seed, head=head)
        for stack, parameters in zip(networks.stacks, drawn.flat, strict=True):
            stack.load(parameters)
        super().__init__(networks, config.actor_rate, config.gradient_clip, target=target)

    def load(self, flat: Sequence[Float32]) -> None:
        """Replace the actors' parameters, [n_v, P_v] for each type in the order of `eia_sec.common.actors`."""
        for stack, parameters in zip(self.networks.stacks, flat, strict=True):
            stack.load(parameters)

    def export(self) -> tuple[Float32, ...]:
        """Return a copy of the actors' parameters, [n_v, P_v] for each type in the order of `eia_sec.common.actors`."""
        return tuple(stack.export().astype(np.float32) for stack in self.networks.stacks)

    def outputs(self, inputs: Inputs) -> Tensor:
        """Return the heads' outputs, before any tanh, flat: type by type, agent by agent, row by row."""
        output: Tensor = self.networks(inputs.actor)
        return output

    def actions(self, inputs: Inputs) -> Tensor:
        """Return a = pi(o) of deterministic actors, in the action layout."""
        return torch.tanh(self.outputs(inputs))

    def next_actions(self, inputs: Inputs) -> Tensor:
        """Return a' = pi'(o') in the action layout: of the target actors, or of the actors where there are none."""
        return torch.tanh(self.target(inputs.actor))
