"""The shared ensemble critics (SEC) of all types: k_s members for each, which every agent of the type asks."""

import torch
from torch import Tensor

from common.actors import initial_parameters
from common.config import AlgorithmConfig
from common.seeds import stream
from common.team import TeamSpec
from learner.networks.compiled_pass import make_pass
from learner.networks.inputs import Inputs, critic_width
from learner.networks.stacked import Networks, Parameters, Stack


class Ensemble:
    """Layout and working memory of all members.

    Args:
        config: the algorithm's configuration.
        team: the layout of the team.
        like: a tensor of the wanted device and type.
        cores: processor cores to compute on by compiled kernels; 0 to compute by torch.

    Attributes:
        values: the predictions [k_s, agents, B] of the last forward pass.
    """

    def __init__(self, config: AlgorithmConfig, team: TeamSpec, like: Tensor, *, cores: int) -> None:
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
        self.values = self._pass.output.view(k_s, team.agents, batch)
        kinds = [kind for kind, group in enumerate(team.groups) for _ in range(group.count)]
        self._kinds = torch.tensor(kinds, device=like.device)

    def initialise(self, flat: Tensor, seed: int) -> None:
        """Draw all members, each its own."""
        for k in range(self._config.ensemble_members):
            for kind, (group, width) in enumerate(zip(self._team.groups, self._widths, strict=True)):
                draw = initial_parameters(width, self._config.hidden, 1, stream(seed, "ensemble", group.name, k))
                self.networks.load(flat, self.index(k, kind), torch.from_numpy(draw[None]))

    def index(self, k: int, kind: int) -> int:
        """Return which stack of the networks the k-th member of a type is."""
        return k * len(self._team.groups) + kind

    def by_agent(self, numbers: Tensor) -> Tensor:
        """Return, for each agent, the mean over its type's members of one number for each stack [stacks]: [agents]."""
        means = numbers.view(self._config.ensemble_members, -1).mean(dim=0)
        return means.index_select(0, self._kinds)

    def _inputs(self, inputs: Inputs) -> list[Tensor]:
        return [x[None] for x in inputs.pooled] * self._config.ensemble_members

    def forward(self, parameters: Parameters, inputs: Inputs, delta: list[Tensor] | None = None) -> Tensor:
        """Compute and return `values`; see `Pass` for `delta`, here for each type [n_v, B, a_v]."""
        self._pass.forward(parameters, self._inputs(inputs), self._pooled(delta) if delta else ())
        return self.values

    def _pooled(self, actions: list[Tensor]) -> list[Tensor]:
        """View a tensor for all agents' rows as one for each member."""
        return [a.flatten(0, 1)[None] for a in actions] * self._config.ensemble_members

    def parameter_gradient(self, parameters: Parameters, inputs: Inputs, upstream: Tensor, into: Parameters) -> None:
        """Write the gradient of sum(upstream * prediction) by the parameters."""
        self._pass.parameter_gradient(parameters, self._inputs(inputs), upstream.reshape(-1), into)

    def action_gradient(self, parameters: Parameters, upstream: Tensor, into: list[Tensor]) -> None:
        """Add the gradient of sum(upstream * prediction) by every agent's own action to `into`."""
        self._pass.action_gradient(parameters, upstream.reshape(-1), self._pooled(into))
