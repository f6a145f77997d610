"""QMIX (Rashid et al., 2018, QMIX: monotonic value function factorisation for deep multi-agent reinforcement learning).

VDN (`eia_sec.learner.off_policy.vdn`) with a mixing network in place of the sum. One update:

 1. Targets, with the networks' choices a*_i of VDN, and x what all agents see:
        Y = reward_scale r + discount (1 - terminated) mix'(x', Q'_1(o'_1, a*_1) .. Q'_N(o'_N, a*_N))
 2. Loss mean_B (mix(x, Q_1(o_1, a_1) .. Q_N(o_N, a_N)) - Y)^2, and one Adam step of each type's network and of the
    mixing network.
 3. Soft targets of all networks, with xi.

The mixing network (`eia_sec.learner.off_policy.mixer`) never falls where an agent's value rises, so that each agent's
best option is its part of the team's.
"""

from collections.abc import Sequence

from torch import Tensor

from eia_sec.common.config import QmixConfig, ValueDecompositionConfig
from eia_sec.common.team import TeamSpec
from eia_sec.learner.off_policy.algorithm import Diagnostics
from eia_sec.learner.off_policy.mixer import Mixer
from eia_sec.learner.off_policy.trained import Trained
from eia_sec.learner.off_policy.vdn import Vdn


class Qmix(Vdn):
    """QMIX; the module gives its equations.

    Attributes:
        mixer: the mixing network and its target.
    """

    def __init__(self, config: QmixConfig, team: TeamSpec, seed: int, like: Tensor, *, cores: int) -> None:
        super().__init__(config, team, seed, like, cores=cores)
        self.mixer = Mixer(config, team, seed, like, cores=cores)

    def retune(self, config: ValueDecompositionConfig) -> None:
        """See `Algorithm`."""
        super().retune(config)
        self.mixer.set_rate(config.critic_rate)

    def tensors(self) -> dict[str, Tensor]:
        """See `Algorithm`."""
        return super().tensors() | self.mixer.tensors("mixer")

    def trained(self) -> Sequence[Trained]:
        """See `Vdn`."""
        return [self.actors, self.mixer]

    def mixed(self, q: Tensor, state: Tensor) -> Tensor:
        """See `Vdn`."""
        return self.mixer(q, state)

    def target_mixed(self, q: Tensor, state: Tensor) -> Tensor:
        """See `Vdn`."""
        return self.mixer.target_value(q, state)

    def _measured(self, team_q: Tensor, target: Tensor) -> Diagnostics:
        """See `Vdn`."""
        norms = self.mixer.norms.expand(self.team.agents)
        return super()._measured(team_q, target)._replace(critic_gradient_norm=norms)
