"""The shared ensemble critics (SEC): k_s members for each type, which all its agents share.

This module holds their networks: values and gradients. Their loss and their step are in
`eia_sec.learner.off_policy.eia_sec`.
"""

import torch
from torch import Tensor

from eia_sec.common.actors import initial_parameters
from eia_sec.common.config import EiaSecConfig
from eia_sec.common.seeds import stream
from eia_sec.common.team import TeamSpec
from eia_sec.learner.networks.compiled_pass import make_pass
from eia_sec.learner.networks.stacked import Networks, Parameters, Stack
from eia_sec.learner.off_policy.critics import QValues
from eia_sec.learner.off_policy.inputs import Inputs, critic_width


class Ensemble:
    """The members of all types: their layout and forward pass. Parameters are passed in.

    Args:
        config: the algorithm's configuration.
        team: the layout of the team.
        like: a tensor of the wanted device and type.
        cores: processor cores for the compiled kernels; 0 to compute by torch.

    Attributes:
        networks: layout of all members.
    """

    def __init__(self, config: EiaSecConfig, team: TeamSpec, like: Tensor, *, cores: int) -> None:
        self._config, self._team = config, team
        k_s, batch = config.ensemble_members, config.batch
        self._widths = [critic_width(team, kind, config.joint_critics) for kind in range(len(team.groups))]
        stacks = [
            Stack(1, width, 1, g.count * batch, 1 + g.observation_size, 0, g.action_size)
            for _ in range(k_s)
            for g, width in zip(team.groups, self._widths, strict=True)
        ]
        self.networks = Networks(stacks, config.hidden)
        self._pass = make_pass(self.networks, like, cores=cores)
        kinds = [kind for kind, group in enumerate(team.groups) for _ in range(group.count)]
        self._kinds = torch.tensor(kinds, device=like.device)

    def initialise(self, flat: Tensor, seed: int) -> None:
        """Draw the parameters of every member."""
        for k in range(self._config.ensemble_members):
            for kind, (group, width) in enumerate(zip(self._team.groups, self._widths, strict=True)):
                draw = initial_parameters(width, self._config.hidden, 1, stream(seed, "ensemble", group.name, k))
                self.networks.load(flat, self.index(k, kind), torch.from_numpy(draw[None]))

    def index(self, k: int, kind: int) -> int:
        """Return the stack of the k-th member of a type."""
        return k * len(self._team.groups) + kind

    def by_agent(self, numbers: Tensor) -> Tensor:
        """Return the mean over the members of each agent's type [agents], given one number for each stack [stacks]."""
        means = numbers.view(self._config.ensemble_members, -1).mean(dim=0)
        return means.index_select(0, self._kinds)

    def q_values(self, parameters: Parameters, inputs: Inputs, change: list[Tensor] | None = None) -> QValues:
        """Return Q_s,k of every agent's action [k_s, agents, B], valid until the next call.

        Args:
            parameters: of all members.
            inputs: observations and actions.
            change: for each type [n_v, B, a_v], what is added to each agent's own action, and to that alone.
        """
        members = self._config.ensemble_members
        rows = [x[None] for x in inputs.pooled] * members
        forward = self._pass.forward(parameters, rows, self._pooled(change) if change else ())
        return QValues(forward.output.view(members, self._team.agents, self._config.batch), forward)

    def _pooled(self, actions: list[Tensor]) -> list[Tensor]:
        """View actions [n_v, B, a_v] of each type as [1, n_v * B, a_v] for each member."""
        return [a.flatten(0, 1)[None] for a in actions] * self._config.ensemble_members

    def parameter_gradient(self, q: QValues, upstream: Tensor, into: Parameters) -> None:
        """Write the gradient of sum(upstream * Q) by the members' parameters."""
        self._pass.parameter_gradient(q.forward, upstream.reshape(-1), into)

    def action_gradient(self, q: QValues, upstream: Tensor, into: list[Tensor]) -> None:
        """Add the gradient of sum(upstream * Q) by every agent's own action to `into`, [n_v, B, a_v] for each type."""
        self._pass.action_gradient(q.forward, upstream.reshape(-1), self._pooled(into))
