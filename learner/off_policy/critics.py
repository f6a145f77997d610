"""Critics of single agents: one or two for each, local or joint.

Q-values are tensors [k, agents, B] in the team's order, k being the critics of an agent. Joint critics are initialised
in the order of an agent's own view (see `eia_sec.learner.off_policy.inputs`), whatever the order of the rows that they
see.
"""

import numpy as np
import torch
from torch import Tensor

from eia_sec.common.actors import initial_parameters
from eia_sec.common.config import OffPolicyConfig
from eia_sec.common.seeds import stream
from eia_sec.common.team import TeamSpec
from eia_sec.learner.networks.stacks import Changes, Shape, Stacks
from eia_sec.learner.off_policy.inputs import Inputs, action_starts, as_rows, critic_width, view_columns
from eia_sec.learner.off_policy.trained import Trained


class Critics(Trained):
    """Every agent's own critics and their targets.

    They are drawn once for each type (A4); the critics of one agent differ.

    Args:
        config: the algorithm's configuration.
        team: the layout of the team.
        seed: seed of the run.
        like: a tensor of the wanted device and type.
        each: critics of one agent, k.
        objective: how many of these the actors' objective takes, from the first one on.
        cores: processor cores for the compiled kernels; 0 to compute by torch.
    """

    def __init__(
        self,
        config: OffPolicyConfig,
        team: TeamSpec,
        seed: int,
        like: Tensor,
        *,
        each: int,
        objective: int,
        cores: int,
    ) -> None:
        self._config, self._team, self.each = config, team, each
        self._objective, self._joint = objective, config.joint_critics
        kinds = range(len(team.groups))
        views = [view_columns(team, kind) for kind in kinds if self._joint]
        self._views = [torch.tensor(columns, device=like.device) for columns in views]
        networks = Stacks([self._shape(kind) for kind in kinds] * each, config.hidden, like, cores=cores)
        self._draw(networks, seed)
        super().__init__(networks, config.critic_rate, config.gradient_clip, target=True)

    def _shape(self, kind: int) -> Shape:
        group, team, batch = self._team.groups[kind], self._team, self._config.batch
        width = critic_width(team, kind, self._joint)
        if self._config.team_objective:
            changes = Changes(0, team.observation_size, 0, team.action_size, shared=True)
        else:
            start, size = action_starts(team, batch)[kind], group.action_size
            first = team.observation_size + team.action_slices()[kind].start if self._joint else group.observation_size
            changes = Changes(start, first, size if self._joint else 0, size)
        return Shape(group.count, width, 1, batch, changes)

    def _draw(self, networks: Stacks, seed: int) -> None:
        hidden = self._config.hidden
        for number, stack in enumerate(networks.stacks):
            k, kind = divmod(number, len(self._team.groups))
            group, width = self._team.groups[kind], critic_width(self._team, kind, self._joint)
            role = "critic" if k == 0 else f"critic {k}"
            draw = initial_parameters(width, hidden, 1, stream(seed, role, group.name, 0))
            drawn = torch.from_numpy(np.stack([draw] * group.count)).to(networks.flat.device)
            stack.load((self._by_rows(kind, drawn) if self._joint else drawn).cpu().numpy())

    def _by_rows(self, kind: int, parameters: Tensor) -> Tensor:
        """Return parameters [n_v, P], whose first layer's rows are in each agent's own order, in that of joint rows."""
        width, hidden = critic_width(self._team, kind, True), self._config.hidden
        first, rest = torch.split(parameters, [width * hidden, parameters.shape[1] - width * hidden], dim=1)
        rows = first.reshape(-1, width, hidden)
        columns = self._views[kind][:, :, None].expand_as(rows)
        found = torch.empty_like(rows).scatter_(1, columns, rows)
        return torch.cat([found.flatten(1), rest], dim=1)

    def __call__(self, inputs: Inputs) -> Tensor:
        """Return Q_k,i of the actions in the inputs [k, agents, B], differentiable by the parameters."""
        return self._values(self.networks, inputs)

    def target_values(self, inputs: Inputs) -> Tensor:
        """Return Q'_k,i of the actions in the inputs [k, agents, B], by the target critics."""
        return self._values(self.target, inputs)

    def _values(self, networks: Stacks, inputs: Inputs) -> Tensor:
        output: Tensor = networks(inputs.critic * self.each)
        return output.view(self.each, -1, self._config.batch)

    def of_policies(self, inputs: Inputs, actions: Tensor) -> Tensor:
        """Return Q_k,i of the actors' actions [k, agents, B], differentiable by these, for the actors' objective.

        In the joint scope the other agents act as `others` says: as in the batch, or by their policies as well. Each
        critic is differentiated by its own agent's action, or where the actors share one objective
        (`others = "team"`) by all actions.

        Args:
            inputs: those of the batch.
            actions: of the actors, in the action layout.
        """
        known = inputs.batch_action
        if self._config.follows_policies:
            known = actions.detach()
            inputs.with_actions(known)
        change = actions - known
        if self._config.team_objective:
            change = as_rows(self._team, self._config.batch, change).flatten()
        output: Tensor = self.networks(inputs.critic * self._objective, change)
        return output.view(self._objective, -1, self._config.batch)
