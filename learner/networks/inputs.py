"""What the networks see: batches of rows turned into one stacked input for each type.

The input of agent i's critic is the row

    [1, o_i, a_i]                                                                      critic_scope local
    [1, o_1 .. o_n, a_1 .. a_n]                                                        joint, the same for all agents

and that of its actor [1, o_i]; the leading one carries the bias (see `learner.networks.stacked`). Critics that a type
shares see the joint row in an order of the agent's own, so that they can tell whose value they are asked for:

    [1, o_i, a_i, o of own type's others, a of own type's others, (o, a) of each other type]

where "others" stand in the order of the team, all observations of a type before all its actions. In that order all
joint critics' parameters are initialised, too.

Actions of all agents also travel in the *action layout*: type by type, agent by agent, row by row, [sum n_v * B * a_v].
"""

import itertools
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from common.team import TeamSpec
from learner.networks import kernels
from learner.networks.compiled_pass import shares, storage

Piece = tuple[int, ...]
"""From, step, size, to and stride, as in `learner.networks.kernels.spread`."""


def view_columns(team: TeamSpec, kind: int) -> list[list[int]]:
    """Return, for each agent of a type, the columns of a row (observations | actions) in the agent's own order."""

    def columns(group: int, agents: Sequence[int]) -> list[int]:
        spec = team.groups[group]
        seen = team.observation_slices()[group].start
        done = team.observation_size + team.action_slices()[group].start
        size, width = spec.observation_size, spec.action_size
        return [seen + a * size + j for a in agents for j in range(size)] + [
            done + a * width + j for a in agents for j in range(width)
        ]

    count = team.groups[kind].count
    rest = [c for g, spec in enumerate(team.groups) if g != kind for c in columns(g, range(spec.count))]
    return [
        columns(kind, [agent]) + columns(kind, [a for a in range(count) if a != agent]) + rest for agent in range(count)
    ]


def critic_width(team: TeamSpec, kind: int, joint: bool) -> int:
    """Return how many numbers a critic of a type sees."""
    group = team.groups[kind]
    return team.observation_size + team.action_size if joint else group.observation_size + group.action_size


def action_views(team: TeamSpec, batch: int, flat: Tensor) -> list[Tensor]:
    """Return views [n_v, B, a_v] of a tensor in the action layout."""
    shapes = [(group.count, batch, group.action_size) for group in team.groups]
    parts = torch.split(flat, [int(np.prod(shape)) for shape in shapes])
    return [part.view(shape) for part, shape in zip(parts, shapes, strict=True)]


def _rows(matrix: Tensor) -> tuple[int, int]:
    """Return where a matrix's first row starts in its storage, and how far its rows are apart."""
    return int(matrix.storage_offset()), int(matrix.stride(0))


class Spread:
    """Copies pieces of rows to where they belong in a flat buffer, all in one call.

    Args:
        pieces: what goes where.
        rows: rows, B.
        out: the buffer.
        cores: processor cores for a compiled loop; 0 to copy by torch on the buffer's device.
    """

    def __init__(self, pieces: Sequence[Piece], rows: int, out: Tensor, cores: int) -> None:
        self._rows, self._out, self._cores = rows, out, cores
        if cores:
            order, self._bounds = shares([size for _, _, size, _, _ in pieces], cores)
            self._table, self._array = np.array(pieces, np.int64)[order], storage(out)
            return
        b = np.arange(rows)[:, None]
        source = [(begin + b * step + np.arange(size)).ravel() for begin, step, size, _, _ in pieces]
        place = [(to + b * stride + np.arange(size)).ravel() for _, _, size, to, stride in pieces]
        self._source, self._place = (torch.from_numpy(np.concatenate(x)).to(out.device) for x in (source, place))

    def __call__(self, source: Tensor) -> None:
        """Copy the pieces of a contiguous tensor."""
        flat = source.reshape(-1)
        if self._cores > 1:
            kernels.spread_on_cores(self._bounds, flat.numpy(), self._table, self._rows, self._array)
        elif self._cores:
            kernels.spread(flat.numpy(), self._table, self._rows, self._array)
        else:
            self._out.index_copy_(0, self._place, flat.index_select(0, self._source))


class Inputs:
    """The stacked inputs of all types for one batch, in one buffer that is allocated once.

    Args:
        team: the layout.
        batch: rows of a batch, B.
        joint: whether critics see all agents.
        like: a tensor of the wanted device and type.
        cores: processor cores to copy on by compiled loops; 0 to copy by torch.
        views: whether a joint scope's rows are wanted in every agent's own order, too.

    Attributes:
        actor: for each type [n_v, B, 1 + o_v].
        critic: for each type [n_v, B, 1 + width]; where the scope is joint, the same rows for all.
        pooled: for each type the rows of all its agents for critics that it shares, [n_v * B, 1 + width].
        acted: the batch's actions in the action layout.
    """

    def __init__(
        self, team: TeamSpec, batch: int, joint: bool, like: Tensor, *, cores: int, views: bool = False
    ) -> None:
        self._team, self._batch, self._joint = team, batch, joint
        width = team.observation_size + team.action_size
        sizes = [g.count * batch * (1 + g.observation_size) for g in team.groups]
        own = [g.count * batch * (1 + g.observation_size + g.action_size) for g in team.groups]
        seen = [g.count * batch * (1 + width) for g in team.groups] if joint and views else []
        acted = batch * team.action_size
        parts = [*sizes, *([batch * (1 + width)] if joint else own), *seen, acted]
        buffer = like.new_ones(sum(parts))
        starts = [0, *itertools.accumulate(parts)]
        pieces = [buffer[a:b] for a, b in itertools.pairwise(starts)]
        kinds = len(team.groups)
        self.actor = [p.view(g.count, batch, -1) for p, g in zip(pieces[:kinds], team.groups, strict=True)]
        self.acted = pieces[-1]
        if joint:
            self._whole = pieces[kinds].view(batch, 1 + width)
            self.critic = [self._whole.expand(g.count, batch, 1 + width) for g in team.groups]
            self.pooled = [p.view(-1, 1 + width) for p in pieces[kinds + 1 : -1]]
            columns = [torch.tensor(view_columns(team, kind)).flatten() for kind in range(len(self.pooled))]
            self._columns = [c.to(like.device) for c in columns]
        else:
            self.critic = [p.view(g.count, batch, -1) for p, g in zip(pieces[kinds:-1], team.groups, strict=True)]
            self.pooled = [x.flatten(0, 1) for x in self.critic]
        self._observe, self._act, self._decide = (Spread(p, batch, buffer, cores) for p in self._pieces())

    def _pieces(self) -> tuple[list[Piece], list[Piece], list[Piece]]:
        """Return where the pieces of observation rows, of action rows and of the action layout go."""
        team, batch = self._team, self._batch
        seen: list[Piece] = []
        done: list[Piece] = []
        decided: list[Piece] = []
        width, actions = team.observation_size, team.action_size
        acted = self.acted.storage_offset()
        for kind, group in enumerate(team.groups):
            o, a = group.observation_size, group.action_size
            for agent in range(group.count):
                look = team.observation_slices()[kind].start + agent * o
                act = team.action_slices()[kind].start + agent * a
                (start, step), (place, stride) = (_rows(x[kind][agent]) for x in (self.actor, self.critic))
                seen.append((look, width, o, start + 1, step))
                done.append((act, actions, a, acted + act * batch, a))
                if self._joint:
                    place += 1 + width + act
                else:
                    seen.append((look, width, o, place + 1, stride))
                    place += 1 + o
                done.append((act, actions, a, place, stride))
                decided.append((act * batch, a, a, place, stride))
        if self._joint:
            place, stride = _rows(self._whole)
            seen.append((0, width, width, place + 1, stride))
        return seen, done, decided

    def observe(self, observation: Tensor) -> None:
        """Fill in every observation from rows [B, O]."""
        self._observe(observation)

    def act(self, action: Tensor) -> None:
        """Fill in every action from rows [B, A]; the observations must be there."""
        self._act(action)
        self._order()

    def decide(self, action: Tensor) -> None:
        """Fill in every action from the action layout; the observations must be there."""
        self._decide(action)
        self._order()

    def _order(self) -> None:
        """Bring joint rows into every agent's own order where that is wanted."""
        if not self._joint:
            return
        for x, columns, group in zip(self.pooled, self._columns, self._team.groups, strict=False):
            view = torch.unflatten(self._whole[:, 1:].index_select(1, columns), 1, (group.count, -1))
            torch.unflatten(x, 0, (group.count, -1))[:, :, 1:].copy_(view.transpose(0, 1))
