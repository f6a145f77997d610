"""IPPO (de Witt et al. 2020): PPO with a value function of an agent's own observation, V_i(o_i)."""

from torch import Tensor

from eia_sec.common.config import OnPolicyConfig
from eia_sec.common.team import GroupSpec
from eia_sec.learner.networks.recurrent import make_stack
from eia_sec.learner.networks.sequences import Sequences, Unroll
from eia_sec.learner.on_policy.ppo import Ppo
from eia_sec.learner.on_policy.values import GroupValue


class OwnValue(GroupValue):
    """V_i(o_i), one network for the type or one for each agent."""

    def __init__(self, config: OnPolicyConfig, group: GroupSpec, seed: int) -> None:
        super().__init__()
        count = 1 if config.shared else group.count
        self.network = make_stack(config, count, group.seen, 1, 1.0, [(seed, "value", group.name, 0)] * count)
        self.states = group.count

    def value(self, team: Tensor, own: Tensor, sequences: Sequences | None = None) -> Tensor:
        """Return V [B, n]."""
        found: Tensor = self.network(own, sequences).squeeze(-1)
        return found

    def unroll(self, team: Tensor, own: Tensor, sequences: Sequences) -> Unroll:
        """Return V and the states after each row."""
        found = self.network.unroll(own, sequences)
        return Unroll(found.outputs.squeeze(-1), found.state)


class Ippo(Ppo):
    """IPPO."""

    def value_function(self, group: GroupSpec, seed: int) -> GroupValue:
        """See `Ppo`."""
        return OwnValue(self.config, group, seed)
