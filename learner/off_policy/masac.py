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
 5. Soft targets of the critics, with xi, after step 2. There are no target actors.

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
from eia_sec.learner.networks.adam import Adam
from eia_sec.learner.off_policy.algorithm import ActorCritic, Batch, Diagnostics
from eia_sec.learner.off_policy.inputs import Inputs
from eia_sec.learner.off_policy.trained import ADAM_EPSILON


class ActionSample(NamedTuple):
    """Actions sampled from the actors.

    Attributes:
        actions: a = tanh(u), in the action layout.
        log_probability: log pi(a) [agents, B].
    """

    actions: Tensor
    log_probability: Tensor


class Masac(ActorCritic[MasacConfig]):
    """MASAC; the module gives its equations."""

    head = "gaussian"
    critics_each = 2
    objective_critics = 2
    noise_blocks = 2

    def __init__(self, config: MasacConfig, team: TeamSpec, seed: int, like: Tensor, *, cores: int) -> None:
        super().__init__(config, team, seed, like, cores=cores)
        self.log_alpha = like.new_full((team.agents,), math.log(config.temperature))
        self._log_alpha = self.log_alpha.detach().requires_grad_()
        self._alpha_adam = Adam([([self._log_alpha], config.temperature_rate)], epsilon=ADAM_EPSILON)
        sizes = [group.action_size for group in team.groups for _ in range(group.count)]
        self._target_entropy = like.new_tensor(sizes) * config.entropy_target
        self._index_outputs(sizes)

    def _index_outputs(self, sizes: list[int]) -> None:
        """Note, for each number of the action layout, its row of [agents * B], and where its m and log s stand."""
        width = torch.tensor(sizes).repeat_interleave(self.config.batch)
        row = torch.arange(width.shape[0]).repeat_interleave(width)
        mean = torch.arange(row.shape[0]) + (torch.cumsum(width, 0) - width)[row]
        self._row, self._mean, self._log_std = (x.to(self.log_alpha.device) for x in (row, mean, mean + width[row]))

    def tensors(self) -> dict[str, Tensor]:
        """See `Algorithm`."""
        moments = self._alpha_adam.moments[self._log_alpha]._asdict()
        own = {f"log_alpha.{name}": tensor for name, tensor in moments.items()}
        return {**super().tensors(), "log_alpha": self.log_alpha, **own}

    def update(self, batch: Batch, noise: Tensor, *, actor_step: bool, diagnostics: bool) -> Diagnostics | None:
        """See `Algorithm`."""
        config = self.config
        inputs, next_inputs = self.inputs(batch)
        alpha = self.log_alpha.exp()[:, None]

        # 1. Targets
        with torch.no_grad():
            following = self._sample(next_inputs, noise[0])
            next_q = self.critics.target_values(next_inputs.with_actions(following.actions))
            next_value = torch.minimum(next_q[0], next_q[1]) - alpha * following.log_probability
            target = self.td_target(batch, next_value)

        # 2. and 5. Critic loss, critic step, target critics
        q = self.critics(inputs)
        critic_loss = self.critic_loss(q, target)
        self.critics.zero_grad()
        critic_loss.backward()
        self.critics.step(norms=diagnostics)
        self.critics.follow(config.target_rate)

        # 3. Actor loss, actor step
        sample = self._sample(inputs, noise[1])
        q_policy = self.critics.of_policies(inputs, sample.actions)
        objective = torch.minimum(q_policy[0], q_policy[1]) - alpha * sample.log_probability
        actor_loss = -objective.mean(dim=1).sum()
        self.actors.zero_grad()
        actor_loss.backward()
        self.actors.step(norms=diagnostics)

        # 4. Temperature loss, temperature step
        log_probability = sample.log_probability.detach().mean(dim=1)
        temperature_loss = -(self._log_alpha.exp() * (log_probability + self._target_entropy)).sum()
        self._alpha_adam.zero_grad()
        temperature_loss.backward()
        self._alpha_adam.step()

        if not diagnostics:
            return None
        return self.measured(q[0], objective, target)._replace(
            temperature=alpha[:, 0], log_probability=log_probability, entropy_regularised=True
        )

    def _sample(self, inputs: Inputs, noise: Tensor) -> ActionSample:
        outputs = self.actors.outputs(inputs)
        log_std = outputs.index_select(0, self._log_std).clamp(*LOG_STD_RANGE)
        u = outputs.index_select(0, self._mean) + log_std.exp() * noise
        correction = 2.0 * (math.log(2.0) - u - softplus(-2.0 * u))
        density = noise.square() * -0.5 - log_std - correction - 0.5 * math.log(2.0 * math.pi)
        rows = self.team.agents * self.config.batch
        log_probability = density.new_zeros(rows).index_add(0, self._row, density).view(-1, self.config.batch)
        return ActionSample(torch.tanh(u), log_probability)
