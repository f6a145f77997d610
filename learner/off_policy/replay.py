"""The replay buffer: a ring of rows, from which transitions are drawn uniformly.

The rows are those of `eia_sec.common.transitions`. Each observation is stored once: a row's next observation is that of
its successor, found by index. If a chunk continues a trajectory of the previous chunk, its first row merges with the
row that is already in the ring (see `eia_sec.learner.off_policy.segments`). A successor is always newer than its row,
so the successor of every row with a step is in the ring.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from eia_sec.common.errors import CheckpointError, ConfigError, EiaSecError, SchemaError
from eia_sec.common.team import Float32, TeamSpec
from eia_sec.common.transitions import TERMINATED, TRANSITION, Rows, Seen, check_actions
from eia_sec.learner.checkpoint.tensor_snapshot import Frozen
from eia_sec.learner.off_policy import replay_kernels
from eia_sec.learner.off_policy.engine import Batch
from eia_sec.learner.off_policy.index_set import IndexSet, Places
from eia_sec.learner.off_policy.segments import Indices, OpenEnds

LARGE = ("observation", "action", "reward")
SMALL = ("flag", "version", "successor", "uses")
MOST_COUNT = 2**62
"""Upper bound of the counters; no run comes near it, and the arrays could not hold larger ones."""
COUNTS = ("head", "rows", "written", "drawn", "dropped", "retired", "retired_uses", "oldest_version")


class Replay:
    """A ring of rows on the engine's device.

    Args:
        team: the layout of the team.
        capacity: rows, D.
        device: torch device of the rows.

    Attributes:
        head: index of the next row.
        rows: rows in the ring.
        written: rows ever written.
        drawn: transitions ever drawn.
        dropped: number of transitions that became too old to be drawn.
        retired: number of transitions that were overwritten.
        retired_uses: how often these had been drawn, in total.
        oldest_version: lowest policy version that may be drawn.
        drawn_version: mean policy version of the rows of the last batch.
        drawn_oldest: lowest policy version among them.
        drawn_places: indices of these rows.
    """

    def __init__(self, team: TeamSpec, capacity: int, device: str = "cpu") -> None:
        self.capacity, self._device, self._team = capacity, torch.device(device), team
        self.observation = torch.zeros(capacity, team.observation_size, device=device)
        self.action = torch.zeros(capacity, team.action_size, device=device)
        self.reward = torch.zeros(capacity, team.agents, device=device)
        # On a CPU, NumPy views of the same memory: creating them for each chunk takes longer than copying a small one.
        self._rows: list[Float32 | Tensor] = [
            large.numpy() if large.device.type == "cpu" else large for large in self._large()
        ]
        self.flag: NDArray[np.uint8] = np.zeros(capacity, np.uint8)
        self.version: NDArray[np.int64] = np.zeros(capacity, np.int64)
        self.successor: Places = np.zeros(capacity, np.int64)
        self.uses: NDArray[np.int64] = np.zeros(capacity, np.int64)
        self.head = self.rows = self.written = self.drawn = self.dropped = self.retired = self.retired_uses = 0
        self.oldest_version = self.drawn_oldest = 0
        self.drawn_version = 0.0
        self.drawn_places: Places = np.zeros(0, np.int64)
        self._drawable = IndexSet(capacity)
        self._ends = OpenEnds()
        self._frozen: list[Frozen] = []

    @property
    def transitions(self) -> int:
        """Rows that may be drawn."""
        return self._drawable.count

    @property
    def occupancy(self) -> float:
        """Share of the ring that holds rows."""
        return self.rows / self.capacity

    @property
    def reuse(self) -> float | None:
        """Mean number of draws of a transition before it is overwritten; None until one has been overwritten."""
        return self.retired_uses / self.retired if self.retired else None

    def add(self, rows: Rows, version: int, source: str = "", number: int = 0) -> None:
        """Copy rows into the ring, over the oldest ones if it is full.

        Args:
            rows: whole segments, checked against the team.
            version: policy version that acted in them.
            source: name of their producer, whose next chunk can continue them; empty if none does.
            number: number of this chunk; a source numbers its chunks consecutively.

        Raises:
            ConfigError: when there are more rows than the ring holds.
        """
        count = rows.flag.shape[0]
        if count > self.capacity:
            raise ConfigError(f"replay.capacity {self.capacity} cannot hold a chunk of {count} rows.")
        self._frozen = [frozen for frozen in self._frozen if not frozen.closed]
        starts, held = self._ends.continued(rows, source, number)
        living = held >= self.written + count - self.capacity
        starts, held = starts[living], held[living]
        small = self.flag, self.version, self.successor, self.uses
        # A copy, because a message's arrays are read-only, and numba would compile the kernel again for that type.
        numbers, new, drawable, gone, uses = replay_kernels.enter(
            rows.flag.copy(), starts, held, version, self.written, *small
        )
        self._copy(rows, new, starts, held % self.capacity)
        self._drawable.exchange(numbers[new] % self.capacity, drawable)
        self.head = (self.head + new.shape[0]) % self.capacity
        self.rows = min(self.capacity, self.rows + new.shape[0])
        self.written += new.shape[0]
        self.retired += gone
        self.retired_uses += uses
        if version < self.oldest_version:
            self.drop_before(self.oldest_version)
        self._ends.remember(rows, numbers, source, number)

    def _copy(self, rows: Rows, new: Indices, starts: Indices, places: Places) -> None:
        """Write new rows at the head, and the actions and rewards of rows whose observations are already stored."""
        first = min(new.shape[0], self.capacity - self.head)
        for start, part in ((self.head, new[:first]), (0, new[first:])):
            if part.shape[0]:
                stop = start + part.shape[0]
                self._protect(start, stop)
                for target, source in zip(self._rows, (rows.observation, rows.action, rows.reward), strict=True):
                    _write(target, start, stop, source, part)
        if starts.shape[0]:
            for place in places.tolist() if self._frozen else ():
                self._protect(place, place + 1)
            where = torch.from_numpy(places).to(self._device)
            self.action[where] = torch.from_numpy(rows.action[starts]).to(self._device)
            self.reward[where] = torch.from_numpy(rows.reward[starts]).to(self._device)

    def _protect(self, start: int, stop: int) -> None:
        """Save rows that are about to change for snapshots that are still being read."""
        for frozen in self._frozen:
            frozen.protect(start, stop)

    def _large(self) -> tuple[Tensor, Tensor, Tensor]:
        return self.observation, self.action, self.reward

    def drop_before(self, version: int) -> None:
        """Stop drawing rows of lower policy versions; they are counted as dropped and stay until overwritten."""
        self.oldest_version = version
        old = np.flatnonzero((self.version[: self.rows] < version) & ((self.flag[: self.rows] & TRANSITION) != 0))
        self.dropped += self._drawable.remove(old)

    def draw(self, count: int, generator: np.random.Generator) -> Places:
        """Return the indices of `count` transitions, drawn uniformly with replacement.

        Raises:
            EiaSecError: when the ring holds no transition that may be drawn.
        """
        if self._drawable.count == 0:
            raise EiaSecError("the replay buffer holds no transition yet.")
        return self._drawable.draw(count, generator)

    def sample(self, count: int, generator: np.random.Generator) -> Batch:
        """Return a batch of transitions on the engine's device; see `draw`."""
        places = self.drawn_places = self.draw(count, generator)
        np.add.at(self.uses, places, 1)
        self.drawn += count
        versions = self.version[places]
        self.drawn_version, self.drawn_oldest = float(versions.mean()), int(versions.min())
        here = torch.from_numpy(places).to(self._device)
        terminated = (self.flag[places] & TERMINATED) != 0
        following = torch.from_numpy(self.successor[places]).to(self._device)
        return Batch(
            observation=self.observation.index_select(0, here),
            action=self.action.index_select(0, here),
            reward=self.reward.index_select(0, here),
            next_observation=self.observation.index_select(0, following),
            terminated=torch.from_numpy(terminated.astype(np.float32)).to(self._device),
        )

    def snapshot(self) -> tuple[dict[str, Tensor | Frozen], dict[str, Any]]:
        """Return the present state: tensors of the ring's first `rows` rows, and values that JSON can hold.

        The large tensors are not copied yet (see `Frozen`); the caller must read or close each of them.
        """
        large = {name: Frozen(tensor, self.rows) for name, tensor in zip(LARGE, self._large(), strict=True)}
        self._frozen += large.values()
        small = {name: torch.from_numpy(getattr(self, name)[: self.rows].copy()) for name in SMALL}
        plain = {**{name: getattr(self, name) for name in COUNTS}, "ends": self._ends.state()}
        return {**large, **small, "drawable": torch.from_numpy(self._drawable.members())}, plain

    def restore(self, tensors: Mapping[str, Tensor], plain: Mapping[str, Any]) -> None:
        """Continue from `snapshot`; if any part does not fit, change nothing.

        Raises:
            CheckpointError: when it does not fit this ring.
        """
        counts, used = self._checked(tensors, plain)
        drawable, ends = IndexSet(self.capacity), OpenEnds()
        drawable.restore(tensors["drawable"].numpy())
        ends.restore(plain["ends"], counts["written"])
        for name, target in self._targets().items():
            target[:used].copy_(tensors[name])
            target[used:].zero_()
        for name, value in counts.items():
            setattr(self, name, value)
        self._drawable, self._ends = drawable, ends

    def _targets(self) -> dict[str, Tensor]:
        return {name: torch.as_tensor(getattr(self, name)) for name in (*LARGE, *SMALL)}

    def _checked(self, tensors: Mapping[str, Tensor], plain: Mapping[str, Any]) -> tuple[dict[str, int], int]:
        if set(tensors) != {*LARGE, *SMALL, "drawable"} or set(plain) != {*COUNTS, "ends"}:
            raise CheckpointError("the replay buffer's fields are not those of this version.")
        if not all(type(plain[name]) is int and 0 <= plain[name] < MOST_COUNT for name in COUNTS):
            raise CheckpointError("a counter of the replay buffer is not a count.")
        counts = {name: plain[name] for name in COUNTS}
        used, written = counts["rows"], counts["written"]
        if used != min(self.capacity, written) or counts["head"] != written % self.capacity:
            raise CheckpointError("the replay buffer's counters do not fit its capacity.")
        for name, target in self._targets().items():
            if tensors[name].shape != (used, *target.shape[1:]) or tensors[name].dtype != target.dtype:
                raise CheckpointError(f"the replay buffer's {name} does not fit the team or the capacity.")
        drawable, successor = tensors["drawable"], tensors["successor"]
        if drawable.dtype != torch.int64 or ((drawable < 0) | (drawable >= used)).any():
            raise CheckpointError("the drawable rows do not fit the replay buffer.")
        if ((successor < 0) | (successor >= used)).any():
            raise CheckpointError("the replay buffer's successors do not fit the replay buffer.")
        if not ((tensors["flag"][drawable] & TRANSITION) != 0).all():
            raise CheckpointError("a row that may be drawn from the replay buffer holds no step.")
        if not all(torch.isfinite(tensors[name]).all() for name in LARGE):
            raise CheckpointError("the replay buffer holds a number that is not finite.")
        try:
            check_actions(tensors["action"].numpy(), self._team)
        except SchemaError as error:
            raise CheckpointError(f"in the replay buffer {error}") from error
        return counts, used


def _write(target: Float32 | Tensor, start: int, stop: int, source: Seen, index: Indices) -> None:
    """Copy the rows `index` of an array to rows start .. stop - 1; on a CPU, without a temporary copy."""
    if isinstance(target, Tensor):
        target[start:stop].copy_(torch.from_numpy(source[index]))
    else:
        np.take(source, index, axis=0, out=target[start:stop], mode="clip")
