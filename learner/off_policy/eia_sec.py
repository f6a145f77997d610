"""EIA-SEC and its ablations: a local critic for every agent, and a shared ensemble critic (SEC) for every type.

For agent i of type v, with members k = 1 .. k_s shared by the type (eq. (value), A6):

    Q_P,i = eps Q_i + (1 - eps) mean_k Q_s,k                      without an ensemble Q_P,i is Q_i

An update is synchronous: every agent's step uses the others' parameters from the same point.

 1. A batch of B rows, the same rows for all agents.
 2. Targets with the parameters from the start of the update (A5, A8):
        a'_i = pi_i(o'_i)
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
    `actor_objective` is local. One Adam step at r_a.

Elite imitation, the other half of the method, acts on the actors between updates (`eia_sec.common.imitation`).
"""

import torch
from torch import Tensor

from eia_sec.common.config import EiaSecConfig
from eia_sec.common.team import TeamSpec
from eia_sec.learner.off_policy.algorithm import ActorCritic, Batch, Diagnostics
from eia_sec.learner.off_policy.ensemble import Ensemble
from eia_sec.learner.off_policy.inputs import Inputs


class EiaSec(ActorCritic[EiaSecConfig]):
    """EIA-SEC, or without its ensemble; the module gives its equations.

    Attributes:
        ensemble: the members of all types and their targets, or None.
    """

    def __init__(self, config: EiaSecConfig, team: TeamSpec, seed: int, like: Tensor, *, cores: int) -> None:
        super().__init__(config, team, seed, like, cores=cores)
        self.ensemble = Ensemble(config, team, seed, like, cores=cores) if config.uses_ensemble else None
        counts = [group.count for group in team.groups for _ in range(group.count)]
        self._type_share = 1.0 / like.new_tensor(counts)

    def retune(self, config: EiaSecConfig) -> None:
        """See `Algorithm`."""
        super().retune(config)
        if self.ensemble is not None:
            self.ensemble.set_rate(config.critic_rate)

    def tensors(self) -> dict[str, Tensor]:
        """See `Algorithm`."""
        return super().tensors() | (self.ensemble.tensors("members") if self.ensemble else {})

    def update(self, batch: Batch, noise: Tensor, *, actor_step: bool, diagnostics: bool) -> Diagnostics | None:
        """See `Algorithm`."""
        config, ensemble = self.config, self.ensemble
        inputs, next_inputs = self.inputs(batch)

        # 2. Targets
        with torch.no_grad():
            next_inputs.with_actions(self.actors.next_actions(next_inputs))
            target = self.td_target(batch, self._next_value(next_inputs))

        # 3. Critic losses, critic steps
        (q,) = self.critics(inputs)
        members = ensemble(inputs) if ensemble and self._needs_members(diagnostics) else None
        error = q - target
        if members is not None and config.ensemble_loss == "mixture":
            error = self._mixture(q, members.detach()) - target
        critic_loss = error.square().mean(dim=1).sum()
        self.critics.zero_grad()
        if ensemble and members is not None and config.ensemble_gradient:
            ensemble.zero_grad()
            critic_loss = critic_loss + self._member_loss(q.detach(), members, target)
        critic_loss.backward()
        self.critics.step(norms=diagnostics)
        if ensemble and config.ensemble_gradient:
            ensemble.step(norms=diagnostics)

        # 4. and 5. Proportional copy, target critics
        if ensemble and config.ensemble_copy_rate > 0.0:
            ensemble.copy_from(self.critics)
        self.critics.follow(config.target_rate)
        if ensemble:
            ensemble.follow(config.target_rate)

        # 6. Actor loss, actor step
        actions = self.actors.actions(inputs)
        (objective,) = self.critics.of_policies(inputs, actions)
        policy_members = None
        if ensemble and config.actor_objective == "mixture":
            policy_members = ensemble(inputs, actions)
            objective = self._mixture(objective, policy_members)
        actor_loss = -objective.mean(dim=1).sum()
        self.actors.zero_grad()
        actor_loss.backward()
        self.actors.step(norms=diagnostics)

        if not diagnostics:
            return None
        if ensemble is None or members is None:
            return self.measured(q, objective, target)
        members = members.detach()
        return self.measured(self._mixture(q.detach(), members), objective, target)._replace(
            td_error=error.detach(),
            member_std=None if policy_members is None else policy_members.detach().std(dim=0, correction=0),
            member_loss=(members - target).square().mean(dim=(0, 2)),
            member_gradient_norm=ensemble.norms_by_agent() if config.ensemble_gradient else None,
        )

    def _mixture(self, local: Tensor, members: Tensor) -> Tensor:
        """Return Q_P = eps Q_i + (1 - eps) mean_k Q_s,k [agents, B]."""
        return torch.lerp(members.mean(dim=0), local, self.config.mixture_epsilon)

    def _next_value(self, next_inputs: Inputs) -> Tensor:
        """Return M' [agents, B]."""
        q = self.critics.target_values(next_inputs)[0]
        if self.ensemble is None or self.config.bootstrap == "local":
            return q
        return self._mixture(q, self.ensemble.target_values(next_inputs))

    def _needs_members(self, diagnostics: bool) -> bool:
        """Return whether step 3 takes the members' values."""
        return diagnostics or self.config.ensemble_gradient or self.config.ensemble_loss == "mixture"

    def _member_loss(self, q: Tensor, members: Tensor, target: Tensor) -> Tensor:
        """Return the sum of all members' losses; each descends the mean over its type's agents."""
        if self.config.ensemble_loss == "mixture":
            losses = (self._mixture(q, members) - target).square().mean(dim=1)
        else:
            losses = (members - target).square().mean(dim=2)
        return (losses * self._type_share).sum()
