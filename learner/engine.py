"""One update round of all agents at once.

A round is synchronous: every agent's step uses what the others had at the same point. For agent i of type v:

 1. A batch of B rows, the same rows for all agents.
 2. Targets with the parameters from the start of the round (A5, A8):
        a'_i = pi_i(o'_i)                                  by the target actor where `target_actor`
        M'_i = eps Q'_i + (1 - eps) mean_k Q'_s,k          or Q'_i alone where `bootstrap` is local
        Y_i  = reward_scale r_i + gamma (1 - terminated) M'_i
 3. Critic step (up1): the losses of `Critics.loss_gradient`, one Adam step of all critics at r_c. Without
    `ensemble_gradient` the SEC takes none.
 4. Proportional copy (up2), for i = 1 .. n_v in turn and each k:
        phi_s,k <- c_k phi_i + (1 - c_k) phi_s,k,   c_k = tau k / k_s
    which comes to phi_s,k <- (1 - c_k)^n_v phi_s,k + sum_i c_k (1 - c_k)^(n_v - i) phi_i.
 5. Soft targets (xt) of local critics and SEC members: phi' <- xi phi + (1 - xi) phi'.
 6. Actor step (up3, A9, A12) with the updated critics: minimise -mean_B Q_P,i(o_i, pi_i(o_i)), or -Q_i alone where
    `actor_objective` is local; in the joint scope the other agents' actions are the batch's. One Adam step at r_a;
    then the target actors follow as in 5 where there are any.
"""

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from common.actors import ActorBank, initial_parameters
from common.config import AlgorithmConfig
from common.seeds import stream
from common.team import Float32, TeamSpec
from learner.critics import Critics
from learner.inputs import Inputs, critic_width
from learner.networks import Bank, Pass, Stack, Workspace
from learner.optimiser import Adam


class Batch(NamedTuple):
    """B transitions of the whole team, on the engine's device.

    Attributes:
        observation: rows [B, O].
        action: rows [B, A].
        reward: [B, agents].
        next_observation: rows [B, O].
        terminated: [B], 1 where nothing is bootstrapped from the next observation, else 0.
    """

    observation: Tensor
    action: Tensor
    reward: Tensor
    next_observation: Tensor
    terminated: Tensor


class Figures(NamedTuple):
    """What one round can tell, each [agents, B].

    Attributes:
        error: the local critics' errors in step 3.
        value: what the actors climb in step 6.
        target: Y.
    """

    error: Tensor
    value: Tensor
    target: Tensor


class Engine:
    """All networks of a run and their update round.

    Args:
        algorithm: the method's configuration.
        team: the layout of the team.
        seed: seed of the run; every initialisation follows from it.
        device: torch device.
        dtype: type of all arithmetic.
    """

    def __init__(
        self,
        algorithm: AlgorithmConfig,
        team: TeamSpec,
        seed: int,
        device: str = "cpu",
        dtype: torch.dtype = torch.float32,
    ) -> None:
        self.algorithm, self.team = algorithm, team
        like = torch.empty(0, device=device, dtype=dtype)
        joint = algorithm.critic_scope == "joint"
        stacks = [Stack(g.count, g.observation_size, g.action_size, algorithm.batch) for g in team.groups]
        self.bank = Bank(stacks, algorithm.hidden)
        self.critics = Critics(algorithm, team, like)
        self._allocate(like)
        self._initialise(seed)
        self._current = Inputs(team, algorithm.batch, joint, like)
        self._next = Inputs(team, algorithm.batch, joint, like)
        self._pass = Pass(self.bank, Workspace(self.bank.rows, algorithm.hidden, like))
        sizes = [g.count * algorithm.batch * g.action_size for g in team.groups]
        shapes = [(g.count, algorithm.batch, g.action_size) for g in team.groups]
        self._squashed = [a.view(shape) for a, shape in zip(torch.split(self._pass.output, sizes), shapes, strict=True)]
        self._upstream = torch.empty_like(self._pass.output)
        self._upstreams = [a.view(s) for a, s in zip(torch.split(self._upstream, sizes), shapes, strict=True)]

    def _allocate(self, like: Tensor) -> None:
        self.actors = like.new_zeros(self.bank.size)
        self.target_actors = like.new_zeros(self.bank.size)
        self.phi = self.critics.parameters(like.new_zeros(self.critics.size))
        self.target_phi = self.critics.parameters(like.new_zeros(self.critics.size))
        self._critic_gradient = self.critics.parameters(like.new_zeros(self.critics.size))
        self._actor_gradient = like.new_zeros(self.bank.size)
        self._actor_layers = self.bank.layers(self.actors)
        self._actor_gradient_layers = self.bank.layers(self._actor_gradient)
        chosen = self.target_actors if self.algorithm.target_actor else self.actors
        self._next_actor_layers = self.bank.layers(chosen)
        trained = slice(0, self.critics.size if self.algorithm.ensemble_gradient else self.critics.local.size)
        rates = self.algorithm.critic_rate, self.algorithm.actor_rate
        self.critic_adam = Adam(self.phi.flat[trained], self._critic_gradient.flat[trained], rates[0])
        self.actor_adam = Adam(self.actors, self._actor_gradient, rates[1])

    def _initialise(self, seed: int) -> None:
        algorithm, hidden = self.algorithm, self.algorithm.hidden
        alike = algorithm.initialisation == "type"
        joint = algorithm.critic_scope == "joint"
        self.load_actors(ActorBank.initial(self.team, hidden, seed, per_type=alike).flat)
        for kind, group in enumerate(self.team.groups):
            width = critic_width(self.team, kind, joint)

            def draw(role: str, name: int, width: int = width, kind: str = group.name) -> Float32:
                return initial_parameters(width, hidden, 1, stream(seed, role, kind, name))

            local = np.stack([draw("critic", 0 if alike else i) for i in range(group.count)])
            self.critics.local.load(self.phi.flat, kind, torch.from_numpy(local))
            if algorithm.ensemble:
                members = np.stack([draw("ensemble", k) for k in range(algorithm.ensemble_members)])
                self.critics.members[kind].load(self.phi.member_parts[kind], 0, torch.from_numpy(members))
        self.target_phi.flat.copy_(self.phi.flat)
        self.target_actors.copy_(self.actors)

    def load_actors(self, flat: tuple[Float32, ...]) -> None:
        """Replace the actors' parameters, [n_v, P_v] for each type in the order of `common.actors`."""
        for kind, parameters in enumerate(flat):
            self.bank.load(self.actors, kind, torch.from_numpy(parameters))

    def export_actors(self) -> tuple[Float32, ...]:
        """Return a copy of the actors' parameters, [n_v, P_v] for each type in the order of `common.actors`."""
        kinds = range(len(self.team.groups))
        return tuple(self.bank.export(self.actors, kind).float().contiguous().cpu().numpy() for kind in kinds)

    @torch.inference_mode()
    def round(self, batch: Batch, *, figures: bool = False) -> Figures | None:
        """Do one update round; return its figures where asked for."""
        self._observe(batch)
        target = self._target(batch)
        error = self.critics.loss_gradient(self.phi, self._current, target, self._critic_gradient)
        self.critic_adam.step()
        self._copy_to_members()
        self.target_phi.flat.lerp_(self.phi.flat, self.algorithm.target_rate)
        value = self._actor_step(figures)
        return Figures(error, value, target) if value is not None else None

    def _observe(self, batch: Batch) -> None:
        self._current.observe(batch.observation)
        self._current.act(batch.action)
        self._current.see_others(batch.observation, batch.action)
        self._next.observe(batch.next_observation)

    def _target(self, batch: Batch) -> Tensor:
        """Return Y [agents, B] (step 2)."""
        self._pass.forward(self._next_actor_layers, self._next.actor).tanh_()
        for action, own in zip(self._squashed, self._next.action, strict=True):
            own.copy_(action)
        if self.algorithm.critic_scope == "joint":
            self._next.see_others(batch.next_observation, self._next.action_rows())
        bootstrap = self.critics.predict(self.target_phi, self._next, mixture=self.algorithm.bootstrap == "mixture")
        going_on = (1.0 - batch.terminated) * self.algorithm.discount
        return torch.addcmul(batch.reward.t() * self.algorithm.reward_scale, bootstrap, going_on)

    def _copy_to_members(self) -> None:
        """Apply the proportional copy (step 4)."""
        tau, k_s = self.algorithm.ensemble_copy_rate, self.algorithm.ensemble_members
        if tau == 0.0 or not self.algorithm.ensemble:
            return
        share = tau * torch.arange(1, k_s + 1, dtype=torch.float64) / k_s
        for kind, (group, flat) in enumerate(zip(self.team.groups, self.phi.member_parts, strict=True)):
            turns = torch.arange(group.count - 1, -1, -1, dtype=torch.float64)
            weights = (share[:, None] * (1.0 - share[:, None]) ** turns).to(flat)
            keep = ((1.0 - share) ** group.count).to(flat)[:, None, None]
            sources = self.critics.local.layers_of(self.phi.flat, kind)
            for source, layer in zip(sources, self.critics.members[kind].layers_of(flat, 0), strict=True):
                layer.mul_(keep).add_(torch.tensordot(weights, source, dims=1))

    def _actor_step(self, figures: bool) -> Tensor | None:
        """Climb (step 6); return what was climbed where asked for."""
        self._pass.forward(self._actor_layers, self._current.actor).tanh_()
        for action, own in zip(self._squashed, self._current.action, strict=True):
            own.copy_(action)
        mixture = self.algorithm.actor_objective == "mixture"
        slopes, value = self.critics.action_gradient(self.phi, self._current, mixture=mixture, value=figures)
        for slope, action, upstream in zip(slopes, self._squashed, self._upstreams, strict=True):
            torch.addcmul(slope, slope * action, action, value=-1.0, out=upstream)
        self._pass.parameter_gradient(
            self._actor_layers, self._current.actor, self._upstream, self._actor_gradient_layers
        )
        self.actor_adam.step()
        if self.algorithm.target_actor:
            self.target_actors.lerp_(self.actors, self.algorithm.target_rate)
        return value
