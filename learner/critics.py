"""Local critics and the shared ensemble critic (SEC) of all types: predictions, mixture and gradients.

For agent i of type v, with members k = 1 .. k_s shared by the type (eq. (value), A6):

    Q_P,i = eps Q_i + (1 - eps) mean_k Q_s,k

Without an ensemble Q_P,i is Q_i. Predictions of all agents are tensors [agents, B] in the team's order.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from common.config import AlgorithmConfig
from common.team import TeamSpec
from learner.inputs import Inputs, critic_width
from learner.networks import Bank, Layers, Pass, Stack, Workspace


@dataclass(frozen=True)
class CriticParameters:
    """Parameters phi of all local critics and SEC members, or of their targets, or a gradient of the same layout.

    Attributes:
        flat: [P], the local critics first, then each type's members.
        local: views of the local critics' layers.
        members: for each type, views of its members' layers; empty without an ensemble.
        member_parts: for each type, its members' part of `flat`.
    """

    flat: Tensor
    local: Layers
    members: list[Layers]
    member_parts: list[Tensor]


class Critics:
    """Layout and working memory of all critics.

    The local critics of all types are computed together. The members of one type see the rows of all its agents,
    so types take turns in one workspace, which then stays in the processor's cache.

    Args:
        algorithm: the method's configuration.
        team: the layout of the team.
        like: a tensor of the wanted device and type.
    """

    def __init__(self, algorithm: AlgorithmConfig, team: TeamSpec, like: Tensor) -> None:
        self._team, self._algorithm = team, algorithm
        joint, hidden = algorithm.critic_scope == "joint", algorithm.hidden
        batch, k = algorithm.batch, algorithm.ensemble_members
        pairs = [(group, critic_width(team, kind, joint)) for kind, group in enumerate(team.groups)]
        self.local = Bank([Stack(g.count, w, 1, batch) for g, w in pairs], hidden, join_inputs=joint)
        self._local_pass = Pass(self.local, Workspace(self.local.rows, hidden, like))
        self._local = self._local_pass.output.view(team.agents, batch)
        members = pairs if algorithm.ensemble else []
        self.members = [Bank([Stack(k, w, 1, g.count * batch, shared=True)], hidden) for g, w in members]
        workspace = Workspace(max((bank.rows for bank in self.members), default=0), hidden, like)
        self._member_passes = [Pass(bank, workspace) for bank in self.members]
        self._values = [
            run.output.view(k, g.count, batch) for run, (g, _) in zip(self._member_passes, members, strict=True)
        ]
        self._mean, self._prediction = torch.empty_like(self._local), torch.empty_like(self._local)
        self._slices = team.agent_slices()
        self.size = self.local.size + sum(bank.size for bank in self.members)

    def parameters(self, flat: Tensor) -> CriticParameters:
        """Return views of a flat vector [size]."""
        parts = list(torch.split(flat[self.local.size :], [bank.size for bank in self.members])) if self.members else []
        members = [bank.layers(part) for bank, part in zip(self.members, parts, strict=True)]
        return CriticParameters(flat, self.local.layers(flat), members, parts)

    def predict(self, parameters: CriticParameters, inputs: Inputs, *, mixture: bool) -> Tensor:
        """Return Q_P, or Q_i alone unless `mixture`, as [agents, B]; valid until the next call."""
        self._local_pass.forward(parameters.local, inputs.joined)
        if not mixture or not self.members:
            return self._local
        for kind, run in enumerate(self._member_passes):
            run.forward(parameters.members[kind], [inputs.pooled[kind]])
            torch.mean(self._values[kind], dim=0, out=self._mean[self._slices[kind]])
        return torch.lerp(self._mean, self._local, self._algorithm.mixture_epsilon, out=self._prediction)

    def loss_gradient(
        self, parameters: CriticParameters, inputs: Inputs, target: Tensor, gradient: CriticParameters
    ) -> Tensor:
        """Write the gradient of every critic's loss and return the errors [agents, B] that the local critics descend.

        ensemble_loss "member": each critic regresses to Y by itself, a member on the rows of all agents of its type.
        "mixture": the loss is mean (Q_P - Y)^2 of each agent; a member descends the mean over its type's agents (A7).

        Args:
            parameters: phi.
            inputs: the batch.
            target: Y [agents, B].
            gradient: where the gradient goes; the members' part stays untouched without `ensemble_gradient`.
        """
        blend = self._algorithm.ensemble_loss == "mixture" and bool(self.members)
        error = self._local_pass.forward(parameters.local, inputs.joined).view_as(target) - target
        if blend or self._algorithm.ensemble_gradient:
            for kind in range(len(self.members)):
                self._member_gradient(kind, parameters, inputs, target, error, gradient)
        share = self._algorithm.mixture_epsilon if blend else 1.0
        upstream = error * (2.0 * share / self._algorithm.batch)
        self._local_pass.parameter_gradient(parameters.local, inputs.joined, upstream, gradient.local)
        return error

    def _member_gradient(
        self,
        kind: int,
        parameters: CriticParameters,
        inputs: Inputs,
        target: Tensor,
        error: Tensor,
        gradient: CriticParameters,
    ) -> None:
        """Write the gradient of one type's members; with the mixture's loss, turn its `error` into Q_P - Y."""
        algorithm, run, values, part = (
            self._algorithm,
            self._member_passes[kind],
            self._values[kind],
            self._slices[kind],
        )
        run.forward(parameters.members[kind], [inputs.pooled[kind]])
        scale = 2.0 / (values.shape[1] * algorithm.batch)
        if algorithm.ensemble_loss == "member":
            values.sub_(target[part]).mul_(scale)
        else:
            epsilon = algorithm.mixture_epsilon
            error[part] = torch.lerp(values.mean(dim=0), self._local[part], epsilon) - target[part]
            values.copy_(error[part] * (scale * (1.0 - epsilon) / algorithm.ensemble_members))
        if algorithm.ensemble_gradient:
            run.parameter_gradient(parameters.members[kind], [inputs.pooled[kind]], run.output, gradient.members[kind])

    def action_gradient(
        self, parameters: CriticParameters, inputs: Inputs, *, mixture: bool, value: bool
    ) -> tuple[list[Tensor], Tensor | None]:
        """Return the gradient of -mean_B(Q_P) of every agent by its own action, eq. (up3) with A12.

        Args:
            parameters: phi.
            inputs: the batch with the actors' actions.
            mixture: whether Q_P is climbed, or Q_i alone.
            value: whether to return what is climbed, too.

        Returns:
            for each type [n_v, B, a_v]; and Q [agents, B] or None.
        """
        algorithm = self._algorithm
        mixture = mixture and bool(self.members)
        climbed = self.predict(parameters, inputs, mixture=mixture).clone() if value else None
        share = algorithm.mixture_epsilon if mixture else 1.0
        scale = -1.0 / algorithm.batch
        self._local_pass.hidden_layers(parameters.local, inputs.joined)
        sums = self._local_pass.first_layer_gradient(parameters.local, share * scale)
        slopes = [self._by_action(kind, self.local, kind, parameters.flat, z) for kind, z in enumerate(sums)]
        if mixture:
            share = (1.0 - share) / algorithm.ensemble_members
            for kind, (run, slope) in enumerate(zip(self._member_passes, slopes, strict=True)):
                run.hidden_layers(parameters.members[kind], [inputs.pooled[kind]])
                (z,) = run.first_layer_gradient(parameters.members[kind], share * scale)
                shared = self._by_action(kind, self.members[kind], 0, parameters.member_parts[kind], z)
                slope.add_(torch.unflatten(shared[0], 0, slope.shape[:2]))
        return slopes, climbed

    def _by_action(self, kind: int, bank: Bank, index: int, flat: Tensor, sums: Tensor) -> Tensor:
        """Return the gradient by the own action [count, rows, a_v], given the one by the first layer's sums."""
        group = self._team.groups[kind]
        start = 1 + group.observation_size
        weights = bank.typed[0][index].weights(flat)[:, start : start + group.action_size]
        return torch.bmm(weights, sums.transpose(1, 2)).transpose(1, 2)
