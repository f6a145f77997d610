"""The states of networks with memory at the beginning of every sequence of an iteration.

At an iteration's start all networks go through all steps once, without gradients. Actors go on from the states that
workers sent with each chunk. Value functions begin each chunk with a state of 0, because workers have none of them:
where a chunk begins inside an episode, they know only what came since. In chunks that hold whole episodes, both see
whole episodes. All updates of the iteration begin sequences with these states, also when the networks have moved.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from eia_sec.common.config import OnPolicyConfig
from eia_sec.common.team import Float32, TeamSpec, slices
from eia_sec.common.transitions import TRANSITION, Rows
from eia_sec.learner.networks.sequences import SequenceLayout, Sequences, TypeSequences, Unroll
from eia_sec.learner.on_policy.experience import split
from eia_sec.learner.on_policy.policies import Policies
from eia_sec.learner.on_policy.values import GroupValue


class IterationStates:
    """An iteration's sequences, and the states at their beginnings.

    Args:
        config: the algorithm's configuration.
        team: the layout of the team.
        rows: the iteration's rows, with states.
        values: the value functions of each type.
        device: torch device.

    Attributes:
        layout: where the sequences are in the rows.
        actors: [N, agents, h] states of the actors.
        values: [N, K, h] states of the value functions of all types, one after another.
    """

    def __init__(
        self, config: OnPolicyConfig, team: TeamSpec, rows: Rows, values: Sequence[GroupValue], device: str
    ) -> None:
        assert rows.state is not None
        self._team, self._device, self._networks = team, device, list(values)
        self._by_type = list(zip(team.agent_slices(), slices(tuple(value.states for value in values)), strict=True))
        self._first = torch.from_numpy(np.ascontiguousarray(rows.state)).to(device)
        self._is_last = (rows.flag & TRANSITION) == 0
        self.layout = SequenceLayout(rows, config.sequence_steps)
        self.actors, self.values = (torch.zeros(shape, device=device) for shape in self.shapes().values())

    def shapes(self) -> dict[str, tuple[int, int, int]]:
        """Return the shapes of the states of actors and of value functions, by their names in a checkpoint."""
        count, size = self.layout.count, self._first.shape[2]
        networks = sum(value.states for value in self._networks)
        return {"actor_state": (count, self._team.agents, size), "value_state": (count, networks, size)}

    def tensors(self) -> dict[str, Tensor]:
        """Return the states by their names in a checkpoint."""
        return dict(zip(self.shapes(), (self.actors, self.values), strict=True))

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Take over states of `shapes`."""
        self.actors, self.values = (tensors[name].to(self._device) for name in self.shapes())

    @torch.no_grad()
    def begin(self, policies: Policies, observation: Tensor) -> Float32:
        """Compute all states; return V [R, agents] of all rows.

        Args:
            policies: the actors.
            observation: [R, O].
        """
        found = torch.zeros(len(observation), self._team.agents, device=self._device)
        nothing = self._first.new_zeros(len(self._first), *self.values.shape[1:])
        self.actors = self._go_through(self._first, partial(self._actors_after, policies, observation))
        self.values = self._go_through(nothing, partial(self._values_after, found, observation))
        result: Float32 = found.cpu().numpy()
        return result

    def _go_through(self, state: Tensor, after: Callable[[NDArray[np.int64], Sequences], Tensor]) -> Tensor:
        """Return the states [N, n, h] at the beginning of all sequences.

        Args:
            state: [E, n, h] of each environment before its first step.
            after: returns the states [L B, n, h] after each of the given rows, which are B sequences.
        """
        starts = state.new_empty(self.layout.count, *state.shape[1:])
        for environments, blocks in self.layout.in_order():
            now = state[environments]
            for numbers in blocks:
                starts[numbers] = now
                now = after(self._rows(numbers), Sequences(self._keep(numbers), now))[-len(numbers) :]
        return starts

    def _actors_after(
        self, policies: Policies, observation: Tensor, rows: NDArray[np.int64], sequences: Sequences
    ) -> Tensor:
        parts = zip(policies.stacks, split(self._team, observation[rows]), self._by_type, strict=True)
        return torch.cat([stack.unroll(own, sequences.of(agents)).state for stack, own, (agents, _) in parts], dim=1)

    def _values_after(
        self, found: Tensor, observation: Tensor, rows: NDArray[np.int64], sequences: Sequences
    ) -> Tensor:
        """Write V of the rows into `found`, and of the last rows of segments whose last step is among them."""
        result = self._unrolled_values(observation[rows], sequences)
        found[rows] = result.outputs
        ended = np.flatnonzero(self._is_last[rows + 1])
        if len(ended):
            last = Sequences(sequences.keep.new_ones(1, len(ended)), result.state[ended])
            found[rows[ended] + 1] = self._unrolled_values(observation[rows[ended] + 1], last).outputs
        return result.state

    def _unrolled_values(self, observation: Tensor, sequences: Sequences) -> Unroll:
        """Return V [L B, agents] of all types, and the states of their networks after each row."""
        own = zip(self._networks, split(self._team, observation), self._by_type, strict=True)
        parts = [value.unroll(observation, seen, sequences.of(states)) for value, seen, (_, states) in own]
        return Unroll(*(torch.cat(tensors, dim=1) for tensors in zip(*parts, strict=True)))

    def _rows(self, numbers: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the rows of sequences, step after step."""
        rows: NDArray[np.int64] = self.layout.rows[:, numbers].reshape(-1)
        return rows

    def _keep(self, numbers: NDArray[np.int64]) -> Tensor:
        return torch.from_numpy(self.layout.keep[:, numbers]).to(self._device)

    def rows_and_sequences(self, numbers: NDArray[np.int64]) -> tuple[NDArray[np.int64], TypeSequences]:
        """Return the rows of sequences, and how the networks of each type go through them."""
        keep = self._keep(numbers)
        actors, values = Sequences(keep, self.actors[numbers]), Sequences(keep, self.values[numbers])
        return self._rows(numbers), [(actors.of(agents), values.of(states)) for agents, states in self._by_type]
