"""What the networks see: batches of rows turned into one stacked input for each type.

The input of agent i of type v is the row

    [1, o_i, a_i]                                                                      critic_scope local
    [1, o_i, a_i, o of own type's others, a of own type's others, (o, a) of each other type]        joint

where "others" stand in the order of the team, all observations of a type before all its actions. The actor's input
[1, o_i] is the beginning of the same row, and the leading one carries the bias (see `learner.networks`).
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from common.team import TeamSpec


def others_columns(team: TeamSpec, kind: int) -> list[list[int]]:
    """Return, for each agent of a type, the columns of a row (observations | actions) that make up its others' view."""
    start = team.observation_size

    def columns(group: int, agents: Sequence[int]) -> list[int]:
        spec = team.groups[group]
        seen = team.observation_slices()[group].start
        done = start + team.action_slices()[group].start
        size, width = spec.observation_size, spec.action_size
        return [seen + a * size + j for a in agents for j in range(size)] + [
            done + a * width + j for a in agents for j in range(width)
        ]

    count = team.groups[kind].count
    rest = [c for g, spec in enumerate(team.groups) if g != kind for c in columns(g, range(spec.count))]
    return [columns(kind, [a for a in range(count) if a != agent]) + rest for agent in range(count)]


class Inputs:
    """The stacked inputs of all types for one batch, in buffers that are allocated once.

    Args:
        team: the layout.
        batch: rows of a batch, B.
        joint: whether critics see all agents.
        like: a tensor of the wanted device and type.

    Attributes:
        critic: for each type [n_v, B, 1 + width].
        actor: for each type the part [n_v, B, 1 + o_v].
        action: for each type the own actions [n_v, B, a_v].
        joined: all types' critic inputs in one tensor where the scope is joint, else as `critic`.
        pooled: for each type the rows of all its agents [1, n_v * B, 1 + width].
    """

    def __init__(self, team: TeamSpec, batch: int, joint: bool, like: Tensor) -> None:
        self._team, self._batch, self._joint = team, batch, joint
        widths = [critic_width(team, kind, joint) for kind in range(len(team.groups))]
        if joint:
            whole = like.new_ones(team.agents, batch, 1 + widths[0])
            self.critic = [whole[part] for part in team.agent_slices()]
            self.joined = [whole]
        else:
            self.critic = [
                like.new_ones(g.count, batch, 1 + width) for g, width in zip(team.groups, widths, strict=True)
            ]
            self.joined = self.critic
        sizes = [(group.observation_size, group.action_size) for group in team.groups]
        self.actor = [x[:, :, : 1 + o] for x, (o, _) in zip(self.critic, sizes, strict=True)]
        self.action = [x[:, :, 1 + o : 1 + o + a] for x, (o, a) in zip(self.critic, sizes, strict=True)]
        self.pooled = [x.flatten(0, 1)[None] for x in self.critic]
        self._others = [
            torch.tensor(others_columns(team, kind), device=like.device).flatten() if joint else None
            for kind in range(len(team.groups))
        ]

    def observe(self, observation: Tensor) -> None:
        """Fill in every agent's own observation from rows [B, O]."""
        for group, part, x in zip(self._team.groups, self._team.observation_slices(), self.critic, strict=True):
            own = torch.unflatten(observation[:, part], 1, (group.count, group.observation_size))
            x[:, :, 1 : 1 + group.observation_size].copy_(own.transpose(0, 1))

    def act(self, action: Tensor) -> None:
        """Fill in every agent's own action from rows [B, A]."""
        for group, part, target in zip(self._team.groups, self._team.action_slices(), self.action, strict=True):
            target.copy_(torch.unflatten(action[:, part], 1, (group.count, group.action_size)).transpose(0, 1))

    def see_others(self, observation: Tensor, action: Tensor) -> None:
        """Fill in what every agent sees of the others; nothing where critics are local."""
        if not self._joint:
            return
        rows = torch.cat((observation, action), dim=1)
        for group, columns, x in zip(self._team.groups, self._others, self.critic, strict=True):
            if columns is not None:
                own = 1 + group.observation_size + group.action_size
                view = torch.unflatten(rows.index_select(1, columns), 1, (group.count, -1))
                x[:, :, own:].copy_(view.transpose(0, 1))

    def action_rows(self) -> Tensor:
        """Return the own actions of all agents as rows [B, A]."""
        return torch.cat([a.transpose(0, 1).flatten(1) for a in self.action], dim=1)


def critic_width(team: TeamSpec, kind: int, joint: bool) -> int:
    """Return how many numbers a critic of a type sees."""
    group = team.groups[kind]
    return team.observation_size + team.action_size if joint else group.observation_size + group.action_size
