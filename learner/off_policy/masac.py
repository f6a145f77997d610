"""MASAC: soft actor-critic (Haarnoja et al., 2018) with centralised twin critics for every agent, as in MADDPG.

The actor's head gives m and log s of a Gaussian; u = m + s n with standard normal n, a = tanh(u), and

    log pi(a) = sum_j [ -n_j^2 / 2 - log s_j - log(2 pi) / 2 - 2 (log 2 - u_j - softplus(-2 u_j)) ],

the last term being log(1 - tanh(u_j)^2). One update, for every agent i at once:

 1. Targets, with next actions a'_j sampled by the actors of all agents j, k = 1, 2:
        Y_i = reward_scale r_i + discount (1 - terminated) (min_k Q'_i,k(x', a') - alpha_i log pi_i(a'_i))
 2. Critic loss sum_k mean_B (Q_i,k(x, a) - Y_i)^2, and one Adam step of both critics.
 3. Actor loss mean_B (alpha_i log pi_i(a_i) - min_k Q_i,k(x, a_1 .., a_i, .. a_N)) with a_i sampled and the others'
    actions from the batch, and one Adam step of each actor.
 4. Temperature loss mean_B -alpha_i (log pi_i(a_i) + H), with H = entropy_target times the size of an action, and one
    Adam step of log alpha_i.
 5. Soft targets of the critics, with xi, in the sweep of step 2. There are no target actors.

Steps 1 and 3 use alpha_i from the start of the update.
"""

import math
from typing import NamedTuple

import torch
from torch import Tensor
from torch.nn.functional import softplus

from eia_sec.common.actors import LOG_STD_RANGE
from eia_sec.common.config import MasacConfig
from eia_sec.common.team import TeamSpec
from eia_sec.learner.networks.optimiser import Adam
from eia_sec.learner.networks.stacked import Forward
from eia_sec.learner.off_policy.algorithm import Algorithm, Batch, Diagnostics
from eia_sec.learner.off_policy.inputs import Inputs


class ActionSample(NamedTuple):
    """Actions sampled from the actors; all but the last two in the action layout.

    Attributes:
        actions: a = tanh(u).
        scaled_noise: s n.
        in_range: 1 where the head's log s was within its range, else 0.
        log_probability: log pi(a) [agents, B].
        forward: the actors' forward pass.
    """

    actions: Tensor
    scaled_noise: Tensor
    in_range: Tensor
    log_probability: Tensor
    forward: Forward


class Masac(Algorithm[MasacConfig]):
    """MASAC; the module gives its equations."""

    head = "gaussian"
    critics_each = 2
    objective_critics = 2
    noise_blocks = 2

    def __init__(self, config: MasacConfig, team: TeamSpec, seed: int, like: Tensor, *, cores: int) -> None:
        super().__init__(config, team, seed, like, cores=cores)
        self.log_alpha = like.new_full((team.agents,), math.log(config.temperature))
        self._alpha_adam = Adam(self.log_alpha, config.temperature_rate, cores=cores)
        sizes = [group.action_size for group in team.groups for _ in range(group.count)]
        self._target_entropy = like.new_tensor(sizes) * config.entropy_target
        self._index_outputs(sizes)

    def _index_outputs(self, sizes: list[int]) -> None:
        """Note, for each number of the action layout, its row of [agents * B], and where its m and log s stand."""
        width = torch.tensor(sizes).repeat_interleave(self.config.batch)
        row = torch.arange(width.shape[0]).repeat_interleave(width)
        mean = torch.arange(row.shape[0]) + (torch.cumsum(width, 0) - width)[row]
        self._row, self._mean, self._log_std = (x.to(self.like.device) for x in (row, mean, mean + width[row]))
        self._output_gradient = self.like.new_zeros(2 * row.shape[0])

    def tensors(self) -> dict[str, Tensor]:
        """See `Algorithm`."""
        adam = self._alpha_adam
        own = {"log_alpha": self.log_alpha, "alpha_mean": adam.mean, "alpha_square": adam.square}
        return {**super().tensors(), **own, "alpha_steps": adam.steps}

    def update(self, batch: Batch, noise: Tensor, *, actor_step: bool, diagnostics: bool) -> Diagnostics | None:
        """See `Algorithm`."""
        config = self.config
        inputs, next_inputs = self.inputs(batch)
        alpha = self.log_alpha.exp()[:, None]

        # 1. Targets
        following = self._sample(next_inputs, noise[0])
        next_q = self.critics.q_values(self._target_parameters, next_inputs.with_actions(following.actions))
        next_value = torch.minimum(next_q.values[0], next_q.values[1]) - alpha * following.log_probability
        target = self.td_target(batch, next_value)

        # 2. and 5. Critic loss, critic step, target critics
        td_error, gradient = self.critic_gradient(inputs, target)
        self.critic_adam.step(gradient, self.target_phi, config.target_rate)

        # 3. Actor loss, actor step
        sample = self._sample(inputs, noise[1])
        q = self.objective_q_values(inputs, sample.actions)
        first = (q.values[0] <= q.values[1]).to(q.values.dtype)
        grad_wrt_q = torch.stack((first, 1.0 - first)) * (-1.0 / config.batch)
        grad_wrt_outputs = self._output_gradients(sample, self.action_gradient(q, grad_wrt_q), alpha)
        self.actors.step_from_outputs(sample.forward, grad_wrt_outputs)

        # 4. Temperature loss, temperature step
        log_probability = sample.log_probability.mean(dim=1)
        if config.temperature_rate > 0.0:
            self._alpha_adam.step(-(alpha[:, 0] * (log_probability + self._target_entropy)))

        if not diagnostics:
            return None
        objective = torch.minimum(q.values[0], q.values[1]) - alpha * sample.log_probability
        return self.measured(td_error[0], objective, target)._replace(
            temperature=alpha[:, 0], log_probability=log_probability, entropy_regularised=True
        )

    def _sample(self, inputs: Inputs, noise: Tensor) -> ActionSample:
        forward = self.actors.outputs(inputs)
        raw = forward.output.index_select(0, self._log_std)
        log_std = raw.clamp(*LOG_STD_RANGE)
        scaled_noise = log_std.exp() * noise
        u = forward.output.index_select(0, self._mean) + scaled_noise
        correction = 2.0 * (math.log(2.0) - u - softplus(-2.0 * u))
        density = noise.square() * -0.5 - log_std - correction - 0.5 * math.log(2.0 * math.pi)
        rows = self.team.agents * self.config.batch
        log_probability = density.new_zeros(rows).index_add_(0, self._row, density).view(-1, self.config.batch)
        return ActionSample(u.tanh_(), scaled_noise, (raw == log_std).to(raw.dtype), log_probability, forward)

    def _output_gradients(self, sample: ActionSample, action_gradient: Tensor, alpha: Tensor) -> Tensor:
        """Return the gradient of the actor loss by m and log s, given that of its Q term by the actions.

        With g the latter, c = alpha / B and d log pi / du = 2 a (n being given), dL/du = g (1 - a^2) + 2 c a,
        dL/dm = dL/du, and dL/dlog s = s n dL/du - c where log s is in range.
        """
        batch, actions = self.config.batch, sample.actions
        weight = (alpha / batch).expand(-1, batch).reshape(-1).index_select(0, self._row)
        by_u = torch.addcmul(action_gradient, action_gradient * actions, actions, value=-1.0) + 2.0 * weight * actions
        by_log_std = (by_u * sample.scaled_noise - weight) * sample.in_range
        return self._output_gradient.index_copy_(0, self._mean, by_u).index_copy_(0, self._log_std, by_log_std)
