"""VDN (Sunehag et al., 2018, Value-decomposition networks for cooperative multi-agent learning).

Every agent has a value Q_i(o_i, a_i) for each of its options, which the agents of a type compute by one network. The
team's value is their sum, so each agent finds its part of the team's best action by itself. One update, with r the mean
of all agents' rewards:

 1. Targets, where the networks choose and the target networks judge (van Hasselt et al., 2016):
        a*_i = argmax_a Q_i(o'_i, a)                                            over the legal options
        Y    = reward_scale r + discount (1 - terminated) sum_i Q'_i(o'_i, a*_i)
 2. Loss mean_B (sum_i Q_i(o_i, a_i) - Y)^2, and one Adam step of each type's network.
 3. Soft targets: phi' <- xi phi + (1 - xi) phi'.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from eia_sec.common.config import ValueDecompositionConfig
from eia_sec.common.team import TeamSpec
from eia_sec.learner.off_policy.algorithm import Algorithm, Batch, Diagnostics
from eia_sec.learner.off_policy.options import OptionValues
from eia_sec.learner.off_policy.trained import Trained


class Vdn(Algorithm[ValueDecompositionConfig]):
    """VDN; the module gives its equations. Its actors are the networks of the agents' values."""

    shared_actors = True

    def __init__(
        self, config: ValueDecompositionConfig, team: TeamSpec, seed: int, like: Tensor, *, cores: int
    ) -> None:
        super().__init__(config, team, seed, like, cores=cores)
        self._values = OptionValues(team, config.batch, like)

    def has_target_actors(self) -> bool:
        """See `Algorithm`."""
        return True

    def trained(self) -> Sequence[Trained]:
        """Return all that takes steps."""
        return [self.actors]

    def mixed(self, q: Tensor, state: Tensor) -> Tensor:
        """Return the team's value [1, B] of agents' values [agents, B] and what all of them see, rows [B, O]."""
        return q.sum(dim=0, keepdim=True)

    def target_mixed(self, q: Tensor, state: Tensor) -> Tensor:
        """Return what `mixed` does, by target networks where there are any."""
        return self.mixed(q, state)

    def update(self, batch: Batch, noise: Tensor, *, actor_step: bool, diagnostics: bool) -> Diagnostics | None:
        """See `Algorithm`."""
        inputs, next_inputs = self.inputs(batch)
        batch = batch._replace(reward=batch.reward.mean(dim=1, keepdim=True))

        # 1. Targets
        with torch.no_grad():
            chooser, judge = self.actors.outputs(next_inputs), self.actors.target_outputs(next_inputs)
            next_q = self._values.highest(chooser, judge, next_inputs)
            target = self.td_target(batch, self.target_mixed(next_q, batch.next_observation))

        # 2. and 3. Loss, steps, target networks
        q = self._values.chosen(self.actors.outputs(inputs), batch.action)
        team_q = self.mixed(q, batch.observation)
        loss = self.critic_loss(team_q, target)
        for networks in self.trained():
            networks.zero_grad()
        loss.backward()
        for networks in self.trained():
            networks.step(norms=diagnostics)
            networks.follow(self.config.target_rate)

        return self._measured(team_q.detach(), target) if diagnostics else None

    def _measured(self, team_q: Tensor, target: Tensor) -> Diagnostics:
        """Return the diagnostics after the steps; the team's values [1, B] are those of every agent."""
        error, target, q = (each.expand(self.team.agents, -1) for each in (team_q - target, target, team_q))
        norms = self.actors.norms_by_agent()
        return Diagnostics(error, None, target, q, actor_gradient_norm=norms, of_team=True)
