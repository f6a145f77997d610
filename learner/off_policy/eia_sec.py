"""EIA-SEC and its ablations: a local critic for every agent, and a shared ensemble critic (SEC) for every type.

For agent i of type v, with members k = 1 .. k_s shared by the type (eq. (value), A6):

    Q_P,i = eps Q_i + (1 - eps) mean_k Q_s,k                      without an ensemble Q_P,i is Q_i

An update is synchronous: every agent's step uses the others' parameters from the same point.

 1. A batch of B rows, the same rows for all agents.
 2. Targets with the parameters from the start of the update (A5, A8):
        a'_i = pi_i(o'_i)                                  by the target actor where `target_actor`
        M'_i = eps Q'_i + (1 - eps) mean_k Q'_s,k          or Q'_i alone where `bootstrap` is local
        Y_i  = reward_scale r_i + discount (1 - terminated) M'_i
 3. Critic losses (up1), and one Adam step of all critics at r_c. With `ensemble_loss` "member" each critic regresses
    to Y by itself, a member on the rows of all agents of its type:
        L_i = mean_B (Q_i - Y_i)^2,   L_s,k = mean_{i of v, B} (Q_s,k - Y_i)^2
    With "mixture" the loss of each agent is mean_B (Q_P,i - Y_i)^2, and a member descends the mean over its type's
    agents (A7). Without `ensemble_gradient` the SEC takes no step.
 4. Proportional copy (up2), for i = 1 .. n_v in turn and each k:
        phi_s,k <- c_k phi_i + (1 - c_k) phi_s,k,   c_k = tau k / k_s
    which equals phi_s,k <- (1 - c_k)^n_v phi_s,k + sum_i c_k (1 - c_k)^(n_v - i) phi_i.
 5. Soft targets (xt) of local critics and SEC members: phi' <- xi phi + (1 - xi) phi'.
 6. Actor loss (up3, A9, A12) with the updated critics: -mean_B Q_P,i(o_i, pi_i(o_i)), or -mean_B Q_i where
    `actor_objective` is local; in the joint scope the other agents' actions are the batch's. One Adam step at r_a;
    then the target actors, if any, follow as in 5.

Elite imitation, the other half of the method, acts on the actors between updates (`eia_sec.common.imitation`).
"""

import torch
from torch import Tensor

from eia_sec.common.config import EiaSecConfig
from eia_sec.learner.off_policy.algorithm import Algorithm, Batch, Diagnostics
from eia_sec.learner.off_policy.critics import QValues
from eia_sec.learner.off_policy.ensemble import Ensemble
from eia_sec.learner.off_policy.inputs import Inputs


class EiaSec(Algorithm[EiaSecConfig]):
    """EIA-SEC, or without its ensemble; the module gives its equations."""

    def has_target_actors(self) -> bool:
        """See `Algorithm`."""
        return self.config.target_actor

    def _build_critics(self, seed: int) -> None:
        """Lay out local critics and members in one vector, so that one sweep of Adam takes all."""
        config = self.config
        self.ensemble = Ensemble(config, self.team, self.like, cores=self.cores) if config.uses_ensemble else None
        local = self.critics.networks.size
        size = local + (self.ensemble.networks.size if self.ensemble else 0)
        self._allocate(size)
        self.critics.initialise(self.phi[:local], seed)
        networks = self.critics.networks.segments()
        if self.ensemble:
            vectors = (self.phi, self.target_phi, self.gradient)
            self.members, self._target_members, self._member_gradient = (
                self.ensemble.networks.parameters(flat[local:]) for flat in vectors
            )
            self.ensemble.initialise(self.members.flat, seed)
            networks = torch.cat((networks, self.ensemble.networks.segments() + networks.max() + 1))
            counts = [group.count for group in self.team.groups for _ in range(group.count)]
            # By an agent's Q of a loss that is a mean over its type: 2 / (n_v B).
            self._type_mean = self.like.new_tensor([2.0 / (count * config.batch) for count in counts])[:, None]
            self._copy_weights = self._proportional_copy()
        self.target_phi.copy_(self.phi)
        self._trained = size if config.ensemble_gradient else local
        self.critic_adam = self._critic_optimiser(self._trained, networks)

    def update(self, batch: Batch, noise: Tensor, *, actor_step: bool, diagnostics: bool) -> Diagnostics | None:
        """See `Algorithm`."""
        inputs, next_inputs = self.inputs(batch)

        # 2. Targets
        next_actions = self.actors.next_actions(next_inputs)
        target = self.td_target(batch, self._next_value(next_inputs.with_actions(next_actions)))

        # 3. Critic losses
        local = self.critics.q_values(self._critic_parameters, inputs)
        members = self._member_values(inputs, wanted=diagnostics)
        td_error, critic_gradient = self._critic_losses(local, members, target)
        if diagnostics:
            q_value, member_loss = self._values_before(local, members, target)

        # 3. to 5. Critic step, proportional copy, target critics
        self._critic_step(critic_gradient)

        # 6. Actor loss, actor step, target actors
        policy = self.actors.policy_actions(inputs)
        local, members, grad_wrt_actions = self._actor_loss(inputs, policy.actions)
        self.actors.step(policy, grad_wrt_actions)

        if not diagnostics:
            return None
        objective = self._mixture(local.values[0], members.values) if members else local.values[0]
        return self.measured(td_error, objective, target)._replace(
            q_value=q_value,
            member_std=members.values.std(dim=0, correction=0) if members else None,
            member_loss=member_loss,
            member_gradient_norm=self._member_gradient_norms(),
        )

    def _mixture(self, local: Tensor, members: Tensor) -> Tensor:
        """Return Q_P = eps Q_i + (1 - eps) mean_k Q_s,k [agents, B]."""
        return torch.lerp(members.mean(dim=0), local, self.config.mixture_epsilon)

    def _next_value(self, next_inputs: Inputs) -> Tensor:
        """Return M' [agents, B]."""
        local = self.critics.q_values(self._target_parameters, next_inputs).values[0]
        if self.ensemble is None or self.config.bootstrap == "local":
            return local
        return self._mixture(local, self.ensemble.q_values(self._target_members, next_inputs).values)

    def _member_values(self, inputs: Inputs, *, wanted: bool) -> QValues | None:
        """Return Q_s,k of the batch's actions where a loss takes them, or they are wanted otherwise."""
        config = self.config
        if self.ensemble is None or not (wanted or config.ensemble_loss == "mixture" or config.ensemble_gradient):
            return None
        return self.ensemble.q_values(self.members, inputs)

    def _critic_losses(self, local: QValues, members: QValues | None, target: Tensor) -> tuple[Tensor, Tensor]:
        """Differentiate the losses of step 3; `_values_before` computes the member loss that is reported.

        Returns:
            What the local critics' loss squares [agents, B], and the gradient by all trained parameters.
        """
        config = self.config
        error, share = local.values[0] - target, 1.0
        if self.ensemble and members:
            if config.ensemble_loss == "mixture":
                error, share = self._mixture(local.values[0], members.values) - target, config.mixture_epsilon
                member_share = (1.0 - config.mixture_epsilon) / config.ensemble_members
                grad_wrt_members = (error * self._type_mean * member_share).expand_as(members.values)
            else:
                grad_wrt_members = (members.values - target) * self._type_mean
            if config.ensemble_gradient:
                self.ensemble.parameter_gradient(members, grad_wrt_members, self._member_gradient)
        self.critics.parameter_gradient(local, error * (2.0 * share / config.batch), self._critic_gradient)
        return error, self.gradient[: self._trained]

    def _critic_step(self, gradient: Tensor) -> None:
        """Do Adam's step of step 3, the proportional copy and the soft targets."""
        rate = self.config.target_rate
        copies = self.ensemble is not None and self.config.ensemble_copy_rate > 0.0
        if self._trained == self.phi.shape[0] and not copies:  # all targets follow in Adam's sweep
            self.critic_adam.step(gradient, self.target_phi, rate)
            return
        self.critic_adam.step(gradient)
        if copies:
            self._copy_to_members()
        self.target_phi.lerp_(self.phi, rate)

    def _actor_loss(self, inputs: Inputs, actions: Tensor) -> tuple[QValues, QValues | None, Tensor]:
        """Differentiate the loss of step 6 by the actors' actions.

        Returns:
            Q_i of these actions; Q_s,k, or None where the objective leaves them out; the gradient in the action layout.
        """
        config, change = self.config, inputs.action_change(actions)
        mixture = self.ensemble is not None and config.actor_objective == "mixture"
        local = self.critics.objective_q_values(self._critic_parameters, inputs, change)
        share = config.mixture_epsilon if mixture else 1.0
        gradient = self._action_gradient.zero_()
        self.critics.action_gradient(
            local, torch.full_like(local.values, -share / config.batch), self._action_gradient_views
        )
        if not (mixture and self.ensemble):
            return local, None, gradient
        members = self.ensemble.q_values(self.members, inputs, change)
        member_share = (share - 1.0) / (config.batch * config.ensemble_members)
        grad_wrt_members = torch.full_like(members.values, member_share)
        self.ensemble.action_gradient(members, grad_wrt_members, self._action_gradient_views)
        return local, members, gradient

    def _proportional_copy(self) -> list[tuple[Tensor, Tensor]]:
        """Return, for each type, the factors of step 4 on local critics [k_s, n_v] and on members [k_s]."""
        tau, k_s = self.config.ensemble_copy_rate, self.config.ensemble_members
        rate = tau * torch.arange(1, k_s + 1, dtype=torch.float64) / k_s
        factors = []
        for group in self.team.groups:
            turns = torch.arange(group.count - 1, -1, -1, dtype=torch.float64)
            weights = rate[:, None] * (1.0 - rate[:, None]) ** turns
            factors.append((weights.to(self.phi), ((1.0 - rate) ** group.count).to(self.phi)))
        return factors

    def _copy_to_members(self) -> None:
        """Do the proportional copy (step 4) as one affine map for each layer."""
        assert self.ensemble is not None
        for kind, (weights, keep) in enumerate(self._copy_weights):
            sources = self._local_layers(kind)
            for k in range(self.config.ensemble_members):
                layers = self.ensemble.networks.layers_of(self.members.flat, self.ensemble.index(k, kind))
                for source, layer in zip(sources, layers, strict=True):
                    layer.mul_(keep[k]).add_(torch.tensordot(weights[k : k + 1], source, dims=1))

    def _local_layers(self, kind: int) -> list[Tensor]:
        """Return the layers of a type's local critics, in the order of each agent's own view."""
        first, *rest = self.critics.networks.layers_of(self._critic_parameters.flat, kind)
        return [self.critics.own_order(kind, first), *rest]

    def _values_before(self, local: QValues, members: QValues | None, target: Tensor) -> tuple[Tensor, Tensor | None]:
        """Return, before the critics' step, Q_P of the batch's actions [agents, B] and the members' losses [agents]."""
        if members is None:
            return local.values[0].clone(), None
        return self._mixture(local.values[0], members.values), (members.values - target).square().mean(dim=(0, 2))

    def _member_gradient_norms(self) -> Tensor | None:
        """Return the norm of a member's newest gradient, mean over the members of each agent's type [agents]."""
        if self.ensemble is None or not self.config.ensemble_gradient:
            return None
        norms = self.critic_adam.norms
        if norms is None:
            return self.ensemble.by_agent(self.ensemble.networks.norms(self._member_gradient.flat))
        return self.ensemble.by_agent(norms[self.team.agents :])
