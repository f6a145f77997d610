"""MAPPO (Yu et al. 2022): PPO with a value function of the observations of all agents, V_i(o_1, ..., o_n)."""

from torch import Tensor

from eia_sec.common.config import OnPolicyConfig
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.learner.networks.recurrent import make_stack
from eia_sec.learner.networks.sequences import Sequences, Unroll
from eia_sec.learner.on_policy.ppo import Ppo
from eia_sec.learner.on_policy.values import GroupValue


class TeamValue(GroupValue):
    """V of the observations of all agents: one network with an output for each agent of the type."""

    def __init__(self, config: OnPolicyConfig, team: TeamSpec, group: GroupSpec, seed: int) -> None:
        super().__init__()
        names = [(seed, "team value", group.name, 0)]
        self.network = make_stack(config, 1, team.observation_size, group.count, 1.0, names)
        self.states = 1

    def value(self, team: Tensor, own: Tensor, sequences: Sequences | None = None) -> Tensor:
        """Return V [B, n]."""
        found: Tensor = self.network(team[:, None], sequences).squeeze(1)
        return found

    def unroll(self, team: Tensor, own: Tensor, sequences: Sequences) -> Unroll:
        """Return V and the states after each row."""
        found = self.network.unroll(team[:, None], sequences)
        return Unroll(found.outputs.squeeze(1), found.state)


class Mappo(Ppo):
    """MAPPO."""

    def value_function(self, group: GroupSpec, seed: int) -> GroupValue:
        """See `Ppo`."""
        return TeamValue(self.config, self.team, group, seed)
