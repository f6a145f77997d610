"""The networks' inputs: a batch of rows copied into one stacked tensor for each type.

The actor of agent i sees the row o_i, and its critic sees

    [o_i, a_i]                                             where critics are local
    [o_1 .. o_n, a_1 .. a_n]                               where they are joint, the same for all agents

The parameters of joint critics are initialised in their agent's own order,

    [o_i, a_i, o of own type's others, a of own type's others, (o, a) of each other type]

where "others" follow the order of the team, and all observations of a type precede all its actions.

The *action layout* holds the actions of all agents type by type, agent by agent, row by row: [sum n_v * B * a_v].
"""

import itertools
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from eia_sec.common.team import TeamSpec


def view_columns(team: TeamSpec, kind: int) -> list[list[int]]:
    """Return, for each agent of a type, the columns of a row (observations | actions) in the agent's own order."""

    def columns(group: int, agents: Sequence[int]) -> list[int]:
        spec = team.groups[group]
        observation = team.observation_slices()[group].start
        action = team.observation_size + team.action_slices()[group].start
        o, a = spec.observation_size, spec.action_size
        return [observation + agent * o + j for agent in agents for j in range(o)] + [
            action + agent * a + j for agent in agents for j in range(a)
        ]

    count = team.groups[kind].count
    rest = [c for g, spec in enumerate(team.groups) if g != kind for c in columns(g, range(spec.count))]
    return [
        columns(kind, [agent]) + columns(kind, [a for a in range(count) if a != agent]) + rest for agent in range(count)
    ]


def critic_width(team: TeamSpec, kind: int, joint: bool) -> int:
    """Return the size of the input of a type's critics."""
    group = team.groups[kind]
    return team.observation_size + team.action_size if joint else group.observation_size + group.action_size


def action_views(team: TeamSpec, batch: int, flat: Tensor) -> list[Tensor]:
    """Return views [n_v, B, a_v] of a tensor in the action layout."""
    shapes = [(group.count, batch, group.action_size) for group in team.groups]
    parts = torch.split(flat, [int(np.prod(shape)) for shape in shapes])
    return [part.view(shape) for part, shape in zip(parts, shapes, strict=True)]


def action_starts(team: TeamSpec, batch: int) -> list[int]:
    """Return where each type's actions start in the action layout."""
    sizes = [group.count * batch * group.action_size for group in team.groups]
    return list(itertools.accumulate(sizes[:-1], initial=0))


def as_rows(team: TeamSpec, batch: int, actions: Tensor) -> Tensor:
    """Return actions in the action layout as rows [B, A]."""
    return torch.cat([view.transpose(0, 1).flatten(1) for view in action_views(team, batch, actions)], dim=1)


class RowLayout:
    """Where each agent's numbers are in a row of the whole team.

    Args:
        sizes: for each type the number of its agents and the size of one agent's part.
    """

    def __init__(self, sizes: Sequence[tuple[int, int]]) -> None:
        starts = itertools.accumulate((count * size for count, size in sizes), initial=0)
        self._parts = [(start, count, size) for start, (count, size) in zip(starts, sizes, strict=False)]

    def by_agent(self, rows: Tensor) -> list[Tensor]:
        """Return, for each type, rows [B, all], whose last stride is 1, as a view [n_v, B, size]."""
        batch, step, offset = rows.shape[0], rows.stride(0), rows.storage_offset()
        return [
            rows.as_strided((count, batch, size), (size, step, 1), offset + start) for start, count, size in self._parts
        ]


def observation_layout(team: TeamSpec) -> RowLayout:
    """Return the layout of rows of observations."""
    return RowLayout([(group.count, group.observation_size) for group in team.groups])


def action_layout(team: TeamSpec) -> RowLayout:
    """Return the layout of rows of actions."""
    return RowLayout([(group.count, group.action_size) for group in team.groups])


class Inputs:
    """The inputs of all networks for one batch, in one buffer that is allocated once.

    Args:
        team: the layout of the team.
        batch: rows of a batch, B.
        joint: whether critics see all agents.
        like: a tensor of the wanted device and type.

    Attributes:
        actor: for each type [n_v, B, o_v].
        critic: for each type [n_v, B, width]; joint critics of all agents see the same rows.
        batch_action: the batch's own actions, in the action layout.
    """

    def __init__(self, team: TeamSpec, batch: int, joint: bool, like: Tensor) -> None:
        self._team, self._batch, self._joint, groups = team, batch, joint, team.groups
        width, actions = team.observation_size + team.action_size, batch * team.action_size
        actor = [g.count * batch * g.observation_size for g in groups]
        local = [g.count * batch * (g.observation_size + g.action_size) for g in groups]
        # Apart, because actors are differentiated after critics' inputs have got their actions.
        parts = [batch * width] if joint else local
        pieces = [piece for sizes in (actor, parts) for piece in torch.split(like.new_zeros(sum(sizes)), sizes)]
        kinds = len(groups)
        self.actor = [p.view(g.count, batch, -1) for p, g in zip(pieces[:kinds], groups, strict=True)]
        if joint:
            self._row = pieces[kinds].view(batch, width)
            self.critic = [self._row.expand(g.count, batch, width) for g in groups]
        else:
            self.critic = [p.view(g.count, batch, -1) for p, g in zip(pieces[kinds:], groups, strict=True)]
        self._observations, self._actions = observation_layout(team), action_layout(team)
        self._split_critic_columns()
        self.batch_action = like.new_zeros(actions)
        self._batch_action_views = action_views(team, batch, self.batch_action)

    def _split_critic_columns(self) -> None:
        """Split the critics' inputs into observations and actions, the latter [n_v, B, a_v] for each type."""
        if self._joint:
            size = self._team.observation_size
            self._critic_observations = [self._row[:, :size]]
            self._critic_actions = self._actions.by_agent(self._row[:, size:])
            return
        sizes = [group.observation_size for group in self._team.groups]
        self._critic_observations = [x[:, :, :o] for x, o in zip(self.critic, sizes, strict=True)]
        self._critic_actions = [x[:, :, o:] for x, o in zip(self.critic, sizes, strict=True)]

    def fill(self, observation: Tensor, action: Tensor | None = None) -> "Inputs":
        """Copy a batch of observations [B, O], and of actions [B, A] where given; return these inputs."""
        rows = self._observations.by_agent(observation)
        for x, part in zip(self.actor, rows, strict=True):
            x.copy_(part)
        for x, part in zip(self._critic_observations, [observation] if self._joint else rows, strict=True):
            x.copy_(part)
        if action is not None:
            parts = self._actions.by_agent(action)
            for own, x, part in zip(self._batch_action_views, self._critic_actions, parts, strict=True):
                own.copy_(part)
                x.copy_(part)
        return self

    def with_actions(self, action: Tensor) -> "Inputs":
        """Set the actions that critics see, given in the action layout; return these inputs."""
        views = action_views(self._team, self._batch, action)
        for x, part in zip(self._critic_actions, views, strict=True):
            x.copy_(part)
        return self
