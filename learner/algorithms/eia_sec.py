"""EIA-SEC and its ablations: a local critic for every agent, and a shared ensemble critic (SEC) for every type.

For agent i of type v, with members k = 1 .. k_s shared by the type (eq. (value), A6):

    Q_P,i = eps Q_i + (1 - eps) mean_k Q_s,k                      without an ensemble Q_P,i is Q_i

An update is synchronous: every agent's step uses what the others had at the same point.

 1. A batch of B rows, the same rows for all agents.
 2. Targets with the parameters from the start of the update (A5, A8):
        a'_i = pi_i(o'_i)                                  by the target actor where `target_actor`
        M'_i = eps Q'_i + (1 - eps) mean_k Q'_s,k          or Q'_i alone where `bootstrap` is local
        Y_i  = reward_scale r_i + discount (1 - terminated) M'_i
 3. Critic step (up1), one Adam step of all critics at r_c. With `ensemble_loss` "member" each critic regresses to Y by
    itself, a member on the rows of all agents of its type; with "mixture" the loss is mean (Q_P - Y)^2 of each agent,
    and a member descends the mean over its type's agents (A7). Without `ensemble_gradient` the SEC takes no step.
 4. Proportional copy (up2), for i = 1 .. n_v in turn and each k:
        phi_s,k <- c_k phi_i + (1 - c_k) phi_s,k,   c_k = tau k / k_s
    which comes to phi_s,k <- (1 - c_k)^n_v phi_s,k + sum_i c_k (1 - c_k)^(n_v - i) phi_i.
 5. Soft targets (xt) of local critics and SEC members: phi' <- xi phi + (1 - xi) phi'.
 6. Actor step (up3, A9, A12) with the updated critics: minimise -mean_B Q_P,i(o_i, pi_i(o_i)), or -Q_i alone where
    `actor_objective` is local; in the joint scope the other agents' actions are the batch's. One Adam step at r_a;
    then the target actors follow as in 5 where there are any.

Elite imitation, the other half of the method, acts on the actors between updates (`common.imitation`).
"""

import torch
from torch import Tensor

from learner.algorithms.base import Algorithm, Batch, Diagnostics
from learner.algorithms.ensemble import Ensemble
from learner.networks.optimiser import Adam


class EiaSec(Algorithm):
    """EIA-SEC, or without its ensemble; see the module."""

    def has_target_actors(self) -> bool:
        """See `Algorithm`."""
        return self.config.target_actor

    def _allocate_critics(self, seed: int) -> None:
        """Lay out local critics and members in one vector, so that one sweep of Adam takes all."""
        config, like = self.config, self.like
        self.ensemble = Ensemble(config, self.team, like, cores=self.cores) if config.uses_ensemble else None
        local = self.critics.networks.size
        size = local + (self.ensemble.networks.size if self.ensemble else 0)
        self.phi, self.target_phi, self.critic_gradient = (like.new_zeros(size) for _ in range(3))
        self.critics.initialise(self.phi[:local], seed)
        vectors = (self.phi, self.target_phi, self.critic_gradient)
        self.critic_views, self.target_views, self.gradient_views = (
            self.critics.networks.parameters(flat[:local]) for flat in vectors
        )
        self.climbed_views = self.critic_views
        networks = self.critics.networks.segments()
        trained = size if config.ensemble_gradient else local
        if self.ensemble:
            self.members, self.target_members, self._member_gradient = (
                self.ensemble.networks.parameters(flat[local:]) for flat in vectors
            )
            self.ensemble.initialise(self.members.flat, seed)
            networks = torch.cat((networks, self.ensemble.networks.segments() + networks.max() + 1))
            self._upstream = torch.zeros_like(self.ensemble.values)
            counts = [group.count for group in self.team.groups for _ in range(group.count)]
            self._scale = like.new_tensor([2.0 / (count * config.batch) for count in counts])[:, None]
            self._weights = self._copy_weights()
        self.target_phi.copy_(self.phi)
        self.critic_adam = Adam(
            self.phi[:trained],
            self.critic_gradient[:trained],
            config.critic_rate,
            cores=self.cores,
            clip=config.gradient_clip,
            networks=networks[:trained],
        )

    def update(self, batch: Batch, noise: Tensor, phase: int, *, diagnostics: bool) -> Diagnostics | None:
        """See `Algorithm`."""
        config = self.config
        self.observe(batch)
        self.next.decide(self.actors.forward(self.next.actor, next_action=True).tanh_())
        value = self.critics.forward(self.target_views, self.next)[0]
        if self.ensemble and config.bootstrap == "mixture":
            value = self._mixed(value, self.ensemble.forward(self.target_members, self.next))
        target = self.bootstrapped(batch, value)
        error, values = self._critic_gradients(target)
        judged = self._judged(error, target, values) if diagnostics else None
        follow = self.target_phi if self.critic_adam.mean.shape == self.phi.shape and not self._copies else None
        self.critic_adam.step(follow, config.target_rate)
        if follow is None:
            self._copy_to_members()
            self.target_phi.lerp_(self.phi, config.target_rate)
        climbed, spread = self._actor_step(diagnostics)
        if judged is None or climbed is None:
            return None
        prediction, loss = judged
        return self.diagnosed(error, climbed, target)._replace(
            prediction=prediction, spread=spread, member_loss=loss, member_gradient=self._member_norms()
        )

    @property
    def _copies(self) -> bool:
        return self.ensemble is not None and self.config.ensemble_copy_rate > 0.0

    def _mixed(self, local: Tensor, members: Tensor) -> Tensor:
        """Return Q_P [agents, B]."""
        return torch.lerp(members.mean(dim=0), local, self.config.mixture_epsilon)

    def _critic_gradients(self, target: Tensor) -> tuple[Tensor, Tensor | None]:
        """Write the gradients of step 3.

        Returns:
            the errors [agents, B] that the local critics descend, and the members' predictions [k_s, agents, B], valid
            until they are asked again, where the gradients took them.
        """
        config, local = self.config, self.critics.forward(self.critic_views, self.current)[0]
        error, share, values = local - target, 1.0, None
        if self.ensemble and (config.ensemble_loss == "mixture" or config.ensemble_gradient):
            values = self.ensemble.forward(self.members, self.current)
            if config.ensemble_loss == "mixture":
                error, share = self._mixed(local, values) - target, config.mixture_epsilon
            if config.ensemble_gradient:
                self._train_members(values, target, error)
        upstream = error * (2.0 * share / config.batch)
        self.critics.parameter_gradient(self.critic_views, self.current, upstream, self.gradient_views)
        return error, values

    def _judged(self, error: Tensor, target: Tensor, values: Tensor | None) -> tuple[Tensor, Tensor | None]:
        """Return Q_P of the batch's actions [agents, B], and the members' losses on each agent's rows [agents]."""
        prediction = error + target
        if self.ensemble is None:
            return prediction, None
        if values is None:  # the SEC that only copies has not been asked
            values = self.ensemble.forward(self.members, self.current)
        if self.config.ensemble_loss == "member":  # else the errors are Q_P's already
            prediction = self._mixed(prediction, values)
        return prediction, (values - target).square().mean(dim=(0, 2))

    def _member_norms(self) -> Tensor | None:
        """Return the norm of a member's newest gradient, mean over the members of each agent's type [agents]."""
        if self.ensemble is None or not self.config.ensemble_gradient:
            return None
        clipped = self.critic_adam.norms
        norms = (
            self.ensemble.networks.norms(self._member_gradient.flat) if clipped is None else clipped[self.team.agents :]
        )
        return self.ensemble.by_agent(norms)

    def _train_members(self, values: Tensor, target: Tensor, error: Tensor) -> None:
        """Write the members' gradients, given their predictions and the mixture's errors."""
        assert self.ensemble is not None
        config = self.config
        if config.ensemble_loss == "member":
            torch.sub(values, target, out=self._upstream).mul_(self._scale)
        else:
            share = (1.0 - config.mixture_epsilon) / config.ensemble_members
            self._upstream.copy_(error * self._scale * share)
        self.ensemble.parameter_gradient(self.members, self.current, self._upstream, self._member_gradient)

    def _copy_to_members(self) -> None:
        """Apply the proportional copy (step 4) as one affine map for each layer."""
        if not self._copies:
            return
        assert self.ensemble is not None
        for kind, (weights, keep) in enumerate(self._weights):
            sources = self._local_layers(kind)
            for k in range(self.config.ensemble_members):
                layers = self.ensemble.networks.layers_of(self.members.flat, self.ensemble.index(k, kind))
                for source, layer in zip(sources, layers, strict=True):
                    layer.mul_(keep[k]).add_(torch.tensordot(weights[k : k + 1], source, dims=1))

    def _copy_weights(self) -> list[tuple[Tensor, Tensor]]:
        """Return, for each type, the factors of the local critics [k_s, n_v] and of the members [k_s]."""
        tau, k_s = self.config.ensemble_copy_rate, self.config.ensemble_members
        share = tau * torch.arange(1, k_s + 1, dtype=torch.float64) / k_s
        factors = []
        for group in self.team.groups:
            turns = torch.arange(group.count - 1, -1, -1, dtype=torch.float64)
            weights = share[:, None] * (1.0 - share[:, None]) ** turns
            factors.append((weights.to(self.phi), ((1.0 - share) ** group.count).to(self.phi)))
        return factors

    def _local_layers(self, kind: int) -> list[Tensor]:
        """Return the layers of a type's local critics, in the order of each agent's own view."""
        first, *rest = self.critics.networks.layers_of(self.critic_views.flat, kind)
        return [self.critics.own_order(kind, first), *rest]

    def _actor_step(self, diagnostics: bool) -> tuple[Tensor | None, Tensor | None]:
        """Climb (step 6); return what was climbed, and how far the members lie apart there, where asked for."""
        config, action = self.config, self.choose()
        mixture = self.ensemble is not None and config.actor_objective == "mixture"
        local = self.critics.appraise(self.climbed_views, self.current, self.change_views)
        climbed, spread = local[0].clone() if diagnostics else None, None
        self.slopes.zero_()
        share = config.mixture_epsilon if mixture else 1.0
        local.fill_(-share / config.batch)
        self.critics.action_gradient(self.climbed_views, local, self.slope_views)
        if mixture and self.ensemble:
            values = self.ensemble.forward(self.members, self.current, self.change_views)
            if climbed is not None:
                climbed, spread = self._mixed(climbed, values), values.std(dim=0, correction=0)
            self._upstream.fill_((share - 1.0) / (config.batch * config.ensemble_members))
            self.ensemble.action_gradient(self.members, self._upstream, self.slope_views)
        self.climb(action)
        return climbed, spread
