"""The actors of all agents on the learner's side: parameters, target parameters, optimiser.

A deterministic head outputs the inverse hyperbolic tangent of the action. A Gaussian head outputs its mean and, behind
it, the logarithm of its standard deviation (see `eia_sec.common.actors`).
"""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from eia_sec.common.actors import Head, TeamActors
from eia_sec.common.config import OffPolicyConfig
from eia_sec.common.team import Float32, TeamSpec
from eia_sec.learner.networks.compiled_pass import make_pass
from eia_sec.learner.networks.optimiser import Adam
from eia_sec.learner.networks.stacked import Forward, Networks, Stack
from eia_sec.learner.off_policy.inputs import Inputs


class PolicyActions(NamedTuple):
    """Actions of deterministic actors for a batch.

    Attributes:
        actions: tanh of the outputs, in the action layout.
        forward: the forward pass, which `Actors.step` takes.
    """

    actions: Tensor
    forward: Forward


class Actors:
    """All actors and, where wanted, target actors.

    Args:
        config: the algorithm's configuration.
        team: the layout of the team.
        like: a tensor of the wanted device and type.
        head: kind of the last layer.
        target: whether there are target actors.
        cores: processor cores for the compiled kernels; 0 to compute by torch.

    Attributes:
        flat: parameters of all actors [P].
        target: those of the target actors, or None.
        gradient: the newest gradient [P].
    """

    def __init__(
        self, config: OffPolicyConfig, team: TeamSpec, like: Tensor, *, head: Head, target: bool, cores: int
    ) -> None:
        self._config, self._team, self.head = config, team, head
        outputs = 2 if head == "gaussian" else 1
        stacks = [Stack(g.count, g.observation_size, outputs * g.action_size, config.batch) for g in team.groups]
        self.networks = Networks(stacks, config.hidden)
        self.flat = like.new_zeros(self.networks.size)
        self.target = like.new_zeros(self.networks.size) if target else None
        self.gradient = like.new_zeros(self.networks.size)
        self._pass = make_pass(self.networks, like, cores=cores)
        self._parameters, self._gradient = (self.networks.parameters(x) for x in (self.flat, self.gradient))
        self._next = self._parameters if self.target is None else self.networks.parameters(self.target)
        self.adam = Adam(
            self.flat,
            config.actor_rate,
            cores=cores,
            clip=config.gradient_clip,
            networks=self.networks.segments(),
        )

    def initialise(self, seed: int) -> None:
        """Draw all parameters: one draw for each type, or one for each agent (A4)."""
        per_type = self._config.initialisation == "type"
        self.load(TeamActors.initial(self._team, self._config.hidden, seed, per_type=per_type, head=self.head).flat)
        if self.target is not None:
            self.target.copy_(self.flat)

    def load(self, flat: Sequence[Float32]) -> None:
        """Replace the actors' parameters, [n_v, P_v] for each type in the order of `eia_sec.common.actors`."""
        for kind, parameters in enumerate(flat):
            self.networks.load(self.flat, kind, torch.from_numpy(parameters))

    def export(self) -> tuple[Float32, ...]:
        """Return a copy of the actors' parameters, [n_v, P_v] for each type in the order of `eia_sec.common.actors`."""
        kinds = range(len(self._team.groups))
        return tuple(self.networks.export(self.flat, kind).float().contiguous().cpu().numpy() for kind in kinds)

    def outputs(self, inputs: Inputs) -> Forward:
        """Return the heads' outputs, before any tanh."""
        return self._pass.forward(self._parameters, inputs.actor)

    def policy_actions(self, inputs: Inputs) -> PolicyActions:
        """Return a = pi(o) of deterministic actors."""
        forward = self.outputs(inputs)
        return PolicyActions(torch.tanh(forward.output), forward)

    def next_actions(self, inputs: Inputs) -> Tensor:
        """Return a' = pi'(o') in the action layout: of the target actors, or of the actors where there are none."""
        return torch.tanh(self._pass.forward(self._next, inputs.actor).output)

    def step(self, policy: PolicyActions, action_gradient: Tensor) -> None:
        """Take one Adam step on a loss, given its gradient by the actions, in the action layout.

        By the chain rule through a = tanh(y), dL/dy = dL/da (1 - a^2).
        """
        upstream = torch.addcmul(action_gradient, action_gradient * policy.actions, policy.actions, value=-1.0)
        self.step_from_outputs(policy.forward, upstream)

    def step_from_outputs(self, forward: Forward, output_gradient: Tensor) -> None:
        """Take one Adam step on a loss, given its gradient by the heads' outputs; target actors then follow."""
        self._pass.parameter_gradient(forward, output_gradient, self._gradient)
        self.adam.step(self.gradient, self.target, self._config.target_rate)

    def gradient_norms(self) -> Tensor:
        """Return the norm of each actor's newest gradient [agents], before any clip."""
        return self.networks.norms(self.gradient) if self.adam.norms is None else self.adam.norms

    def tensors(self) -> dict[str, Tensor]:
        """Return the whole state by name."""
        state = {"actors": self.flat, "actor_mean": self.adam.mean, "actor_square": self.adam.square}
        state["actor_steps"] = self.adam.steps
        return state if self.target is None else {**state, "target_actors": self.target}
