"""Critics of single agents: one or two for each, local or joint.

Predictions of all agents are tensors [k, agents, B] in the team's order, k being the critics of an agent. Their
parameters are one flat vector; they are initialised, loaded and exported in the order of an agent's own view (see
`learner.networks.inputs`), whatever the order of the rows that they see.
"""

import numpy as np
import torch
from torch import Tensor

from common.actors import initial_parameters
from common.config import AlgorithmConfig
from common.seeds import stream
from common.team import TeamSpec
from learner.networks.compiled_pass import make_pass
from learner.networks.inputs import Inputs, critic_width, view_columns
from learner.networks.stacked import Networks, Parameters, Stack


class Critics:
    """Layout and working memory of every agent's own critics.

    Args:
        config: the algorithm's configuration.
        team: the layout of the team.
        like: a tensor of the wanted device and type.
        each: critics of one agent, k.
        climbed: how many of these the actors climb, from the first one on.
        cores: processor cores to compute on by compiled kernels; 0 to compute by torch.

    Attributes:
        networks: all of them.
        climbed_networks: those that the actors climb.
    """

    def __init__(
        self, config: AlgorithmConfig, team: TeamSpec, like: Tensor, *, each: int, climbed: int, cores: int
    ) -> None:
        self._config, self._team, self.each = config, team, each
        self._climbed = climbed
        self._joint = config.joint_critics
        self.networks = Networks(
            [self._stack(kind) for _ in range(each) for kind in range(len(team.groups))], config.hidden
        )
        self._orders = [
            torch.tensor([[0, *(1 + c for c in own)] for own in view_columns(team, kind)], device=like.device)
            for kind in range(len(team.groups) if self._joint else 0)
        ]
        self._pass = self._ascent = make_pass(self.networks, like, cores=cores)
        self.climbed_networks = self.networks
        if climbed < each:
            self.climbed_networks = self.networks.part(climbed * len(team.groups))
            self._ascent = make_pass(self.climbed_networks, like, cores=cores)
        self._values = self._pass.output.view(each, team.agents, config.batch)
        self._climbed_values = self._ascent.output.view(climbed, team.agents, config.batch)

    def _stack(self, kind: int) -> Stack:
        group, width = self._team.groups[kind], critic_width(self._team, kind, self._joint)
        own, step = 1 + group.observation_size, 0
        if self._config.climbs_together:
            own = 1 + self._team.observation_size
            return Stack(group.count, width, 1, self._config.batch, own, 0, self._team.action_size)
        if self._joint:
            own = 1 + self._team.observation_size + self._team.action_slices()[kind].start
            step = group.action_size
        return Stack(group.count, width, 1, self._config.batch, own, step, group.action_size)

    def initialise(self, flat: Tensor, seed: int) -> None:
        """Draw all parameters: the critics of a type alike or each its own (A4), those of one agent different."""
        hidden, alike = self._config.hidden, self._config.initialisation == "type"
        for kind, group in enumerate(self._team.groups):
            width = critic_width(self._team, kind, self._joint)
            for k in range(self.each):
                role = "critic" if k == 0 else f"critic {k}"
                names = [0 if alike else index for index in range(group.count)]
                draws = [initial_parameters(width, hidden, 1, stream(seed, role, group.name, name)) for name in names]
                self.load(flat, k, kind, torch.from_numpy(np.stack(draws)))

    def load(self, flat: Tensor, k: int, kind: int, parameters: Tensor) -> None:
        """Write the k-th critics of a type, [n_v, P] in the order of `common.actors`."""
        self.networks.load(flat, self._index(k, kind), self._reordered(kind, parameters, inward=True))

    def export(self, flat: Tensor, k: int, kind: int) -> Tensor:
        """Return a copy of the k-th critics of a type, [n_v, P] in the order of `common.actors`."""
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

    def forward(self, parameters: Parameters, inputs: Inputs) -> Tensor:
        """Return all predictions [k, agents, B], valid until the next call."""
        self._pass.forward(parameters, inputs.critic * self.each)
        return self._values

    def appraise(self, parameters: Parameters, inputs: Inputs, delta: list[Tensor] | None = None) -> Tensor:
        """Return those predictions that the actors climb, likewise; see `Pass` for `delta`."""
        self._ascent.forward(parameters, inputs.critic * self._climbed, delta * self._climbed if delta else ())
        return self._climbed_values

    def parameter_gradient(self, parameters: Parameters, inputs: Inputs, upstream: Tensor, into: Parameters) -> None:
        """Write the gradient of sum(upstream * prediction) by the parameters."""
        self._pass.parameter_gradient(parameters, inputs.critic * self.each, upstream.reshape(-1), into)

    def action_gradient(self, parameters: Parameters, upstream: Tensor, into: list[Tensor]) -> None:
        """Add the gradient of sum(upstream * prediction) by every agent's own action to `into`, after `appraise`.

        Where actors climb the sum of all critics (`others = "team"`), the action of a critic is that of the whole team.
        """
        self._ascent.action_gradient(parameters, upstream.reshape(-1), into * self._climbed)
