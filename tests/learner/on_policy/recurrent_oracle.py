"""The plain PPO of `oracle` for networks with memory: torch.nn.GRUCell, one row after another, one agent at a time."""

import itertools
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from eia_sec.common.team import TeamSpec
from eia_sec.common.transitions import TRANSITION, Rows
from tests.learner.on_policy.oracle import Agent, Oracle


class Rememberer(nn.Module):
    """A hidden layer, a GRU cell and an output layer.

    Attributes:
        sequences: for each of the sequences in the rows of the next call, the state before its first row [h], and for
            each row whether an episode begins with it.
        states: state after each row of the last call, [B, h].
    """

    def __init__(self, tensors: dict[str, Tensor], name: str, index: int) -> None:
        super().__init__()
        w1, b1, w, b, u, c, w3, b3 = (tensors[f"networks.{name}.layers.{layer}"][index] for layer in range(8))
        self.first, self.last = nn.Linear(*w1.shape), nn.Linear(*w3.shape)
        self.cell = nn.GRUCell(len(u), len(u))
        pairs = [(self.first, w1, b1), (self.last, w3, b3)]
        with torch.no_grad():
            for layer, weight, bias in pairs:
                layer.weight.copy_(weight.T)
                layer.bias.copy_(bias)
            for mine, theirs in zip(self.cell.parameters(), (w.T, u.T, b, c), strict=True):
                mine.copy_(theirs)
        self.sequences: list[tuple[Tensor, list[bool]]] = []
        self.states = torch.zeros(0)

    def forward(self, x: Tensor) -> Tensor:
        rows, states = iter(torch.relu(self.first(x))), []
        for state, begins in self.sequences:
            for begin in begins:
                state = self.cell(next(rows), torch.zeros_like(state) if begin else state)  # noqa: PLW2901  # it goes on
                states.append(state)
        self.states = torch.stack(states)
        assert len(states) == len(x)
        return self.last(self.states)

    def flat(self) -> Tensor:
        """Return the parameters in the order of `eia_sec.common.actors`."""
        cell = self.cell.weight_ih.T, self.cell.bias_ih, self.cell.weight_hh.T, self.cell.bias_hh
        parts = self.first.weight.T, self.first.bias, *cell, self.last.weight.T, self.last.bias
        return torch.cat([part.reshape(-1) for part in parts]).detach()


class RecurrentOracle(Oracle):
    """All agents of a team whose networks have memory."""

    network = Rememberer

    def iteration(self, rows: Rows, progress: float) -> None:
        """Learn from an iteration's rows; `progress` is the finished share of the run."""
        count, length = len(rows.state), self.config.sequence_steps
        steps = np.flatnonzero(rows.flag & TRANSITION)
        size = len(steps) // count
        places = [steps[e * size : (e + 1) * size] for e in range(count)]
        ends = [0, *(int(place[-1]) + 2 for place in places)]
        self.whole = [range(a, b) for a, b in itertools.pairwise(ends)]
        self.cut = [places[e][b * length : (b + 1) * length] for b in range(size // length) for e in range(count)]
        self.begins = [row > 0 and rows.flag[row - 1] == 0 and row not in ends for row in range(len(rows.flag))]
        self.starts: dict[tuple[int, int], list[Tensor]] = {}
        self.now: list[Any] = self.whole
        self.first = torch.from_numpy(rows.state)
        for agent in self.agents:
            self._note_starts(agent, rows, self.team)
        super().iteration(rows, progress)

    def _note_starts(self, agent: Agent, rows: Rows, team: TeamSpec) -> None:
        """Keep the states of an agent's networks before each sequence."""
        kind = team.groups.index(agent.group)
        own = torch.from_numpy(team.split_observations(rows.observation)[kind][:, agent.index].copy())
        whole = torch.from_numpy(rows.observation)
        for module in (agent.actor, *agent.values):
            first = self.first[:, agent.place] if module is agent.actor else torch.zeros_like(self.first[:, 0])
            module.sequences = [(first[e], [self.begins[row] for row in part]) for e, part in enumerate(self.whole)]
            with torch.no_grad():
                module(whole if self.config.sees_team and module is not agent.actor else own)
            states = module.states
            self.starts[agent.place, id(module)] = [
                first[k % len(self.whole)] if row in self._firsts() else states[row - 1]
                for k, row in enumerate(part[0] for part in self.cut)
            ]

    def _firsts(self) -> list[int]:
        return [part[0] for part in self.whole]

    def _lead(self, agent: Agent, module: Any) -> None:
        """Prepare a network for the rows that come next."""
        if self.now is self.whole:
            nothing = torch.zeros(len(self.whole), self.config.hidden)
            states = list(self.first[:, agent.place] if module is agent.actor else nothing)
        else:
            states = [self.starts[agent.place, id(module)][k] for k in self.now]
        parts = self.whole if self.now is self.whole else [self.cut[k] for k in self.now]
        module.sequences = [
            (state, [self.begins[row] for row in part]) for state, part in zip(states, parts, strict=True)
        ]

    def value(self, agent: Agent, module: nn.Module, own: Tensor, team: Tensor) -> Tensor:
        self._lead(agent, module)
        return super().value(agent, module, own, team)

    def policy(self, agent: Agent, own: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
        self._lead(agent, agent.actor)
        return super().policy(agent, own, action)

    def _learnt(self, member: int, members: int, rows: int) -> Any:
        lengths = [len(self.cut[k]) for k in self.now]
        owner = np.repeat(np.arange(len(lengths)), lengths)
        first = member % len(lengths)
        return np.flatnonzero((owner >= first) & ((owner - first) % members == 0))

    def _minibatches(self, used: Any) -> Any:
        order = self.random.permutation(np.arange(len(self.cut)))
        for numbers in np.array_split(order, round(len(used) / self.config.minibatch_steps)):
            self.now = list(numbers)
            yield np.concatenate([self.cut[k] for k in numbers])
        self.now = self.whole
