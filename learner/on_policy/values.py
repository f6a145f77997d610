"""The value functions of all types, and their losses.

A type's value is, by algorithm,

    ippo      V_i(o_i): of the agent's own observation
    mappo     V_i(o_1, ..., o_n): of the observations of all agents
    eia-ppo   V_P,i = eps V_i(o_i) + (1 - eps) mean_k V_s,k(o_i), the mixture of eq. (value) with values in place of Q

Every network regresses to the return by itself (A7): L = sum over networks of mean((V - R)^2).
"""

from abc import ABC, abstractmethod

import torch
from torch import Tensor, nn

from common.config import OnPolicyConfig
from common.team import GroupSpec, TeamSpec
from learner.on_policy.networks import Stack
from learner.on_policy.policies import initialisation_names


class GroupValue(nn.Module, ABC):
    """The value functions of one type's agents."""

    @abstractmethod
    def value(self, team: Tensor, own: Tensor) -> Tensor:
        """Return V [B, n].

        Args:
            team: rows [B, O] of all agents' observations.
            own: [B, n, o] the type's observations.
        """

    def loss(self, team: Tensor, own: Tensor, returns: Tensor) -> Tensor:
        """Return mean((V - R)^2) against the returns [B, n]."""
        return (self.value(team, own) - returns).square().mean()


class OwnValue(GroupValue):
    """V_i(o_i), one network for the type or one for each agent."""

    def __init__(self, config: OnPolicyConfig, group: GroupSpec, seed: int) -> None:
        super().__init__()
        count = 1 if config.parameters == "shared" else group.count
        names = initialisation_names("value", group, count, seed, per_type=config.initialisation == "type")
        self.network = Stack(count, group.observation_size, config.hidden, 1, 1.0, names)

    def value(self, team: Tensor, own: Tensor) -> Tensor:
        """Return V [B, n]."""
        found: Tensor = self.network(own).squeeze(-1)
        return found


class TeamValue(GroupValue):
    """V of the observations of all agents: one network with an output for each agent of the type."""

    def __init__(self, config: OnPolicyConfig, team: TeamSpec, group: GroupSpec, seed: int) -> None:
        super().__init__()
        names = [(seed, "team value", group.name, 0)]
        self.network = Stack(1, team.observation_size, config.hidden, group.count, 1.0, names)

    def value(self, team: Tensor, own: Tensor) -> Tensor:
        """Return V [B, n]."""
        found: Tensor = self.network(team[:, None]).squeeze(1)
        return found


class MixedValue(GroupValue):
    """V_P,i: a local value function for each agent, mixed with an ensemble that the type shares."""

    def __init__(self, config: OnPolicyConfig, group: GroupSpec, seed: int) -> None:
        super().__init__()
        self._weight = config.local_weight
        self.local = OwnValue(config, group, seed)
        self.members = nn.ModuleList(
            Stack(1, group.observation_size, config.hidden, 1, 1.0, [(seed, "member", group.name, index)])
            for index in range(config.ensemble_size)
        )

    def value(self, team: Tensor, own: Tensor) -> Tensor:
        """Return V_P [B, n]."""
        local = self.local.value(team, own)
        shared = torch.stack([member(own).squeeze(-1) for member in self.members]).mean(dim=0)
        return self._weight * local + (1.0 - self._weight) * shared

    def loss(self, team: Tensor, own: Tensor, returns: Tensor) -> Tensor:
        """Return the sum of all networks' losses."""
        losses = [(member(own).squeeze(-1) - returns).square().mean() for member in self.members]
        return torch.stack([self.local.loss(team, own, returns), *losses]).sum()


def make_values(config: OnPolicyConfig, team: TeamSpec, seed: int) -> list[GroupValue]:
    """Return the value functions of each type that the algorithm asks for."""
    if config.sees_team:
        return [TeamValue(config, team, group, seed) for group in team.groups]
    if config.ensemble_size:
        return [MixedValue(config, group, seed) for group in team.groups]
    return [OwnValue(config, group, seed) for group in team.groups]
