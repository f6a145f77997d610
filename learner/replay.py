"""The replay buffer: a ring of rows, from which transitions are drawn uniformly.

Rows are those of `common.transitions`: the successor of row t is row t + 1, modulo the capacity. A row can be drawn
when its TRANSITION flag is set and its successor is still in the ring. The newest row never can, so what lies behind
the write head, an old row or none, is never taken for a successor.
"""

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from common.errors import CheckpointError, ConfigError, EiaSecError
from common.team import TeamSpec
from common.transitions import TERMINATED, TRANSITION, Rows
from learner.engine import Batch

FIELDS = ("observation", "action", "reward", "flag", "version")


class Replay:
    """A ring of rows on the engine's device.

    Args:
        team: the layout of the team.
        capacity: rows, D.
        device: torch device of the rows.

    Attributes:
        head: where the next row goes.
        rows: rows in the ring.
        transitions: rows in the ring from which a step follows.
        drawn_version: mean policy version behind the rows of the last batch.
    """

    def __init__(self, team: TeamSpec, capacity: int, device: str = "cpu") -> None:
        self.capacity, self._device = capacity, torch.device(device)
        self.observation = torch.zeros(capacity, team.observation_size, device=device)
        self.action = torch.zeros(capacity, team.action_size, device=device)
        self.reward = torch.zeros(capacity, team.agents, device=device)
        self.flag: NDArray[np.uint8] = np.zeros(capacity, np.uint8)
        self.version: NDArray[np.int64] = np.zeros(capacity, np.int64)
        self.head = self.rows = self.transitions = 0
        self.drawn_version = 0.0

    def add(self, rows: Rows, version: int) -> None:
        """Copy rows in, over the oldest ones where the ring is full.

        Args:
            rows: whole segments, checked against the team.
            version: policy version that acted in them.

        Raises:
            ConfigError: when there are more rows than the ring holds.
        """
        count = rows.flag.shape[0]
        if count > self.capacity:
            raise ConfigError(f"replay.capacity {self.capacity} cannot hold a chunk of {count} rows.")
        first = min(count, self.capacity - self.head)
        self._write(self.head, rows, slice(0, first), version)
        self._write(0, rows, slice(first, count), version)
        self.head = (self.head + count) % self.capacity
        self.rows = min(self.capacity, self.rows + count)

    def _write(self, start: int, rows: Rows, part: slice, version: int) -> None:
        place = slice(start, start + part.stop - part.start)
        self.transitions -= int(np.count_nonzero(self.flag[place] & TRANSITION))
        for target, source in (
            (self.observation, rows.observation),
            (self.action, rows.action),
            (self.reward, rows.reward),
        ):
            target[place].copy_(torch.from_numpy(np.require(source[part], requirements=["C", "W"])))
        self.flag[place] = rows.flag[part]
        self.version[place] = version
        self.transitions += int(np.count_nonzero(self.flag[place] & TRANSITION))

    @property
    def occupancy(self) -> float:
        """Share of the ring that holds rows."""
        return self.rows / self.capacity

    def draw(self, count: int, generator: np.random.Generator) -> NDArray[np.int64]:
        """Return the places of `count` transitions, drawn uniformly with replacement.

        Raises:
            EiaSecError: when the ring holds no transition.
        """
        newest = (self.head - 1) % self.capacity
        if self.transitions - int(self.flag[newest] & TRANSITION) <= 0:
            raise EiaSecError("the replay buffer holds no transition yet.")
        oldest = (self.head - self.rows) % self.capacity
        found: list[NDArray[np.int64]] = []
        missing = count
        while missing > 0:
            places = oldest + generator.integers(0, self.rows - 1, size=missing + missing // 8 + 8)
            places %= self.capacity
            places = places[(self.flag[places] & TRANSITION) != 0][:missing]
            found.append(places)
            missing -= places.shape[0]
        return found[0] if len(found) == 1 else np.concatenate(found)

    def sample(self, count: int, generator: np.random.Generator) -> Batch:
        """Return a batch of transitions on the engine's device; see `draw`."""
        places = self.draw(count, generator)
        successors = places + 1
        successors[successors == self.capacity] = 0
        self.drawn_version = float(self.version[places].mean())
        here = torch.from_numpy(places).to(self._device)
        terminated = (self.flag[places] & TERMINATED) != 0
        return Batch(
            observation=self.observation.index_select(0, here),
            action=self.action.index_select(0, here),
            reward=self.reward.index_select(0, here),
            next_observation=self.observation.index_select(0, torch.from_numpy(successors).to(self._device)),
            terminated=torch.from_numpy(terminated.astype(np.float32)).to(self._device),
        )

    def state(self) -> dict[str, Tensor]:
        """Return the rows in use, by field; the ring's first `rows` places."""
        used = self.rows
        arrays = {name: torch.as_tensor(getattr(self, name))[:used].cpu() for name in FIELDS}
        arrays["ring"] = torch.tensor([self.head, self.rows], dtype=torch.int64)
        return arrays

    def restore(self, state: dict[str, Tensor]) -> None:
        """Continue from `state`.

        Raises:
            CheckpointError: when it does not fit this ring.
        """
        if set(state) != {*FIELDS, "ring"} or state["ring"].shape != (2,) or state["ring"].dtype != torch.int64:
            raise CheckpointError("the replay buffer's fields are not those of this version.")
        head, used = (int(value) for value in state["ring"])
        filling = used < self.capacity
        if not (0 <= used <= self.capacity and 0 <= head < self.capacity) or (filling and head != used):
            raise CheckpointError("the replay buffer's counters do not fit its capacity.")
        targets = {name: torch.as_tensor(getattr(self, name)) for name in FIELDS}
        for name, target in targets.items():
            if state[name].shape != (used, *target.shape[1:]) or state[name].dtype != target.dtype:
                raise CheckpointError(f"the replay buffer's {name} does not fit the team or the capacity.")
        for name, target in targets.items():
            target[:used].copy_(state[name])
        self.flag[used:] = 0
        self.head, self.rows = head, used
        self.transitions = int(np.count_nonzero(self.flag & TRANSITION))
