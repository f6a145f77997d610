"""Critics of single agents: one or two for each, local or joint.

Q-values are tensors [k, agents, B] in the team's order, k being the critics of an agent. The parameters of all critics
are one flat vector. They are initialised, loaded and exported in the order of an agent's own view (see
`eia_sec.learner.off_policy.inputs`), whatever the order of the rows that the critics see.
"""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from eia_sec.common.actors import initial_parameters
from eia_sec.common.config import OffPolicyConfig
from eia_sec.common.seeds import stream
from eia_sec.common.team import TeamSpec
from eia_sec.learner.networks.compiled_pass import make_pass
from eia_sec.learner.networks.stacked import Forward, Networks, Parameters, Stack
from eia_sec.learner.off_policy.inputs import Inputs, critic_width, view_columns


class QValues(NamedTuple):
    """Values that critics predict.

    Attributes:
        values: [k, agents, B].
        forward: the forward pass, which the gradients take.
    """

    values: Tensor
    forward: Forward


class Critics:
    """Every agent's own critics: their layout and forward pass. Parameters are passed in.

    Args:
        config: the algorithm's configuration.
        team: the layout of the team.
        like: a tensor of the wanted device and type.
        each: critics of one agent, k.
        objective: how many of these the actors' objective takes, from the first one on.
        cores: processor cores for the compiled kernels; 0 to compute by torch.

    Attributes:
        networks: layout of all critics.
        objective_networks: layout of those that the actors' objective takes, in the same flat vector.
    """

    def __init__(
        self, config: OffPolicyConfig, team: TeamSpec, like: Tensor, *, each: int, objective: int, cores: int
    ) -> None:
        self._config, self._team, self.each = config, team, each
        self._objective = objective
        self._joint = config.joint_critics
        kinds = range(len(team.groups))
        self.networks = Networks([self._stack(kind) for _ in range(each) for kind in kinds], config.hidden)
        self._orders = [
            torch.tensor([[0, *(1 + c for c in own)] for own in view_columns(team, kind)], device=like.device)
            for kind in (kinds if self._joint else ())
        ]
        self._pass = self._objective_pass = make_pass(self.networks, like, cores=cores)
        self.objective_networks = self.networks
        if objective < each:
            self.objective_networks = self.networks.part(objective * len(kinds))
            self._objective_pass = make_pass(self.objective_networks, like, cores=cores)

    def _stack(self, kind: int) -> Stack:
        group, width = self._team.groups[kind], critic_width(self._team, kind, self._joint)
        own, step = 1 + group.observation_size, 0
        if self._config.team_objective:
            own = 1 + self._team.observation_size
            return Stack(group.count, width, 1, self._config.batch, own, 0, self._team.action_size)
        if self._joint:
            own = 1 + self._team.observation_size + self._team.action_slices()[kind].start
            step = group.action_size
        return Stack(group.count, width, 1, self._config.batch, own, step, group.action_size)

    def initialise(self, flat: Tensor, seed: int) -> None:
        """Draw all parameters: one draw for each type, or for each agent (A4); the critics of one agent differ."""
        hidden, per_type = self._config.hidden, self._config.initialisation == "type"
        for kind, group in enumerate(self._team.groups):
            width = critic_width(self._team, kind, self._joint)
            for k in range(self.each):
                role = "critic" if k == 0 else f"critic {k}"
                names = [0 if per_type else index for index in range(group.count)]
                draws = [initial_parameters(width, hidden, 1, stream(seed, role, group.name, name)) for name in names]
                self.load(flat, k, kind, torch.from_numpy(np.stack(draws)))

    def load(self, flat: Tensor, k: int, kind: int, parameters: Tensor) -> None:
        """Write the k-th critics of a type, [n_v, P] in the order of `eia_sec.common.actors`."""
        self.networks.load(flat, self._index(k, kind), self._reordered(kind, parameters, inward=True))

    def export(self, flat: Tensor, k: int, kind: int) -> Tensor:
        """Return a copy of the k-th critics of a type, [n_v, P] in the order of `eia_sec.common.actors`."""
        return self._reordered(kind, self.networks.export(flat, self._index(k, kind)), inward=False)

    def _index(self, k: int, kind: int) -> int:
        return k * len(self._team.groups) + kind

    def _reordered(self, kind: int, parameters: Tensor, *, inward: bool) -> Tensor:
        """Return the parameters with the first layer's rows in the order of joint rows, or back in the agent's own."""
        if not self._joint:
            return parameters
        width, hidden = critic_width(self._team, kind, True), self._config.hidden
        result = parameters.clone()
        for agent, columns in enumerate(view_columns(self._team, kind)):
            source = parameters[agent, : width * hidden].view(width, hidden)
            target = result[agent, : width * hidden].view(width, hidden)
            if inward:
                target[columns] = source
            else:
                target.copy_(source[columns])
        return result

    def own_order(self, kind: int, first: Tensor) -> Tensor:
        """Return a type's first layers [n_v, 1 + width, hidden] with their rows in the order of each agent's view."""
        if not self._joint:
            return first
        return first.gather(1, self._orders[kind][:, :, None].expand_as(first))

    def q_values(self, parameters: Parameters, inputs: Inputs) -> QValues:
        """Return Q_k,i of the actions in the inputs, valid until the next call."""
        forward = self._pass.forward(parameters, inputs.critic * self.each)
        return QValues(forward.output.view(self.each, -1, self._config.batch), forward)

    def objective_q_values(self, parameters: Parameters, inputs: Inputs, change: list[Tensor] | None = None) -> QValues:
        """Return Q_k,i of the critics that the actors' objective takes, valid until the next call.

        Args:
            parameters: of `objective_networks`.
            inputs: observations and actions.
            change: for each type [n_v, B, a_v], what is added to each agent's own action, and to that alone.
        """
        changes = change * self._objective if change else ()
        forward = self._objective_pass.forward(parameters, inputs.critic * self._objective, changes)
        return QValues(forward.output.view(self._objective, -1, self._config.batch), forward)

    def parameter_gradient(self, q: QValues, upstream: Tensor, into: Parameters) -> None:
        """Write the gradient of sum(upstream * Q) by the parameters, given the result of `q_values`."""
        self._pass.parameter_gradient(q.forward, upstream.reshape(-1), into)

    def action_gradient(self, q: QValues, upstream: Tensor, into: list[Tensor]) -> None:
        """Add the gradient of sum(upstream * Q) by every agent's own action, given that of `objective_q_values`.

        Args:
            q: the values.
            upstream: [k, agents, B].
            into: for each type [n_v, B, a_v]. Where actors share one objective (`others = "team"`), the action of a
                critic is that of the whole team.
        """
        self._objective_pass.action_gradient(q.forward, upstream.reshape(-1), into * self._objective)
