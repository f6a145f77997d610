"""The shared ensemble critics (SEC): k_s members for each type, which all its agents share.

Their loss and their step are in `eia_sec.learner.off_policy.eia_sec`.
"""

import itertools

import torch
from torch import Tensor

from eia_sec.common.actors import initial_parameters
from eia_sec.common.config import EiaSecConfig
from eia_sec.common.seeds import stream
from eia_sec.common.team import TeamSpec
from eia_sec.learner.networks.stacks import Changes, Shape, Stacks
from eia_sec.learner.off_policy.critics import Critics
from eia_sec.learner.off_policy.inputs import Inputs, action_starts, critic_width
from eia_sec.learner.off_policy.trained import Trained


class Ensemble(Trained):
    """The members of all types and their targets.

    Args:
        config: the algorithm's configuration.
        team: the layout of the team.
        seed: seed of the run.
        like: a tensor of the wanted device and type.
        cores: processor cores for the compiled kernels; 0 to compute by torch.
    """

    def __init__(self, config: EiaSecConfig, team: TeamSpec, seed: int, like: Tensor, *, cores: int) -> None:
        self._config, self._team = config, team
        k_s, starts = range(config.ensemble_members), action_starts(team, config.batch)
        shapes = [self._shape(kind, start) for kind, start in enumerate(starts)]
        networks = Stacks(shapes * len(k_s), config.hidden, like, cores=cores)
        members = itertools.product(k_s, team.groups)
        for (k, group), shape, stack in zip(members, networks.shapes, networks.stacks, strict=True):
            draw = stream(seed, "ensemble", group.name, k)
            stack.load(initial_parameters(shape.inputs, config.hidden, 1, draw)[None])
        super().__init__(networks, config.critic_rate, config.gradient_clip, target=True)
        self._copies = self._proportional_copy()

    def _shape(self, kind: int, start: int) -> Shape:
        """Return the stack of one member of a type, whose agents' rows it sees one after another."""
        group, width = self._team.groups[kind], critic_width(self._team, kind, False)
        changes = Changes(start, group.observation_size, 0, group.action_size)
        return Shape(1, width, 1, group.count * self._config.batch, changes)

    def __call__(self, inputs: Inputs, actions: Tensor | None = None) -> Tensor:
        """Return Q_s,k of every agent's action [k_s, agents, B].

        Args:
            inputs: those of the batch.
            actions: in the action layout, in place of the batch's. With them, the values are differentiable by the
                actions alone, else by the parameters.
        """
        return self._values(self.networks, inputs, None if actions is None else actions - inputs.batch_action)

    def target_values(self, inputs: Inputs) -> Tensor:
        """Return Q'_s,k of every agent's action [k_s, agents, B], by the target members."""
        return self._values(self.target, inputs)

    def _values(self, networks: Stacks, inputs: Inputs, change: Tensor | None = None) -> Tensor:
        members = self._config.ensemble_members
        output: Tensor = networks([x.flatten(0, 1)[None] for x in inputs.critic] * members, change)
        return output.view(members, -1, self._config.batch)

    def norms_by_agent(self) -> Tensor:
        """Return the mean of `norms` over the members of each agent's type [agents]."""
        means = self.norms.view(self._config.ensemble_members, -1).mean(dim=0)
        return torch.cat([mean.expand(group.count) for mean, group in zip(means, self._team.groups, strict=True)])

    def _proportional_copy(self) -> list[tuple[Tensor, Tensor]]:
        """Return, for each type, the factors of `copy_from` on local critics [k_s, n_v] and on members [k_s, 1]."""
        tau, k_s = self._config.ensemble_copy_rate, self._config.ensemble_members
        rate = tau * torch.arange(1, k_s + 1, dtype=torch.float64)[:, None] / k_s
        factors = []
        for group in self._team.groups:
            turns = torch.arange(group.count - 1, -1, -1, dtype=torch.float64)
            weights, keep = rate * (1.0 - rate) ** turns, (1.0 - rate) ** group.count
            factors.append((weights.to(self.networks.flat), keep.to(self.networks.flat)))
        return factors

    @torch.no_grad()
    def copy_from(self, critics: Critics) -> None:
        """Do the proportional copy (up2) from each agent's critic: phi_s,k <- keep_k phi_s,k + sum_i w_k,i phi_i."""
        kinds = len(self._copies)
        for kind, (weights, keep) in enumerate(self._copies):
            copied = weights @ critics.networks.stacks[kind].flat
            for stack, part, kept in zip(self.networks.stacks[kind::kinds], copied, keep, strict=True):
                stack.flat.mul_(kept).add_(part)
