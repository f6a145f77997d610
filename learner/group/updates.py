"""The updates of an iteration by a group of learners: each computes gradients from its own share of every minibatch.

    leader: values of all rows, from everybody           followers: values of their rows
            advantages and returns, as one learner
            each minibatch: its samples to everybody
    all:    gradients of their samples, averaged with the samples' numbers as weights; the same clip and step of Adam

Whatever belongs to a run is the leader's alone: followers get parameters, moments and scales with each iteration. So a
checkpoint does not depend on the number of learners, and neither does what they learn, but for the order of samples.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
import torch
import xxhash
from numpy.typing import NDArray
from torch import Tensor

from eia_sec.common.config import LearnerConfig, OnPolicyConfig
from eia_sec.common.errors import GroupError
from eia_sec.common.team import Float32, TeamSpec
from eia_sec.common.transitions import Rows, observation_type
from eia_sec.learner.checkpoint.array_tensors import as_tensor
from eia_sec.learner.group.process_group import Order, Ordered, ProcessGroup
from eia_sec.learner.group.shares import Shares
from eia_sec.learner.on_policy.minibatch import Minibatch
from eia_sec.learner.on_policy.updates import COMPUTED, Updates

ACTORS, VALUES = ("actor_loss", "entropy", "kl", "clipped_share"), ("value_loss",)
"""What an update measures of a type, besides norms of gradients."""
LEARNT: Final = (*COMPUTED, "log_probability")
"""What followers get of their rows before the first minibatch."""


class GroupUpdates(Updates):
    """What leader and followers do alike; see `Updates` for the arguments.

    Args:
        group: the group.
    """

    def __init__(
        self, config: OnPolicyConfig, team: TeamSpec, seed: int, learner: LearnerConfig, group: ProcessGroup
    ) -> None:
        super().__init__(config, team, seed, learner)
        self._group = group
        self._sizes: list[int] = []

    def _with(self, config: OnPolicyConfig) -> "GroupUpdates":
        return type(self)(config, self._team, self._seed, self._learner, self._group)

    def _state(self) -> list[Tensor]:
        """Return parameters, moments, and what networks' inputs and returns are scaled by."""
        return [*self._adam.tensors(), *(tensor for _, tensor in self._scales.named_tensors())]

    def _gradients(self, batch: Minibatch) -> list[dict[str, Tensor]]:
        """Compute the gradients of this learner's samples, and average them over all learners."""
        found = super()._gradients(batch) if self._sizes[self._group.rank] else self._nothing(batch)
        weights = self._weights()
        moving = [parameter for parameter in self._adam.moments if parameter.grad is not None]
        gradients = [parameter.grad for parameter in moving if parameter.grad is not None]
        share, dtype = self._sizes[self._group.rank] / sum(self._sizes), gradients[0].dtype
        numbers = [
            measured[name].to(dtype) * share
            for kind, measured in enumerate(found)
            for name in _measured(stopped=batch.stopped[kind])
        ]
        parts = [gradient.flatten() * weights[parameter] for parameter, gradient in zip(moving, gradients, strict=True)]
        flat = torch.cat([*parts, torch.stack(numbers)])
        self._group.sum(flat)
        *sums, measurements = torch.split(flat, [*(part.numel() for part in parts), len(numbers)])
        for gradient, total in zip(gradients, sums, strict=True):
            gradient.copy_(total.view_as(gradient))
        averages = iter(measurements.unbind())
        return [{name: next(averages) for name in _measured(stopped=stopped)} for stopped in batch.stopped]

    def _nothing(self, batch: Minibatch) -> list[dict[str, Tensor]]:
        """Return the part of a learner that has none of a minibatch's samples, which no mean counts."""
        for kind, networks in enumerate(zip(self.policies.stacks, self.values, strict=True)):
            for parameter in (each for part in networks[batch.stopped[kind] :] for each in part.parameters()):
                parameter.grad = torch.zeros_like(parameter)
        zero = torch.zeros(())
        return [dict.fromkeys(_measured(stopped=stopped), zero) for stopped in batch.stopped]

    def _weights(self) -> dict[Tensor, float]:
        """Return this learner's share of the rows that each parameter learns from."""
        found: dict[Tensor, float] = {}
        own, every = self._sizes[self._group.rank], sum(self._sizes)
        found |= {parameter: own / every for parameter in self.policies.parameters()}
        for value in self.values:
            everybody = [dict(value.rows_learnt(rows)) for rows in self._sizes]
            mine = everybody[self._group.rank]
            found |= {each: rows / sum(other[each] for other in everybody) for each, rows in mine.items()}
        return found

    def _compare(self) -> None:
        """Raise GroupError unless all learners hold the same parameters and moments."""
        found = xxhash.xxh3_64()
        for tensor in self._adam.tensors():
            found.update(np.ascontiguousarray(tensor.detach().numpy()).data)
        if not self._group.agree(found.intdigest() >> 2):
            raise GroupError(
                f"the {self._group.size} learners of this group hold different parameters, which only a defect or "
                "different processors and versions of torch explain."
            )


class LeadingUpdates(GroupUpdates):
    """The leader's updates, in place of `Updates`."""

    _shares: Shares

    def begin(self, rows: Rows, steps: int) -> None:
        """See `Updates`."""
        super().begin(rows, steps)
        self._send_computed()

    def resume(self, rows: Rows, tensors: dict[str, Tensor], stopped: list[bool]) -> None:
        """See `Updates`."""
        super().resume(rows, tensors, stopped)
        self._send_computed()

    def _load(self, rows: Rows) -> None:
        """Prepare the leader's own rows, and send the others theirs."""
        samples = self.samples(rows)
        block = max(1, self._config.ensemble_size)
        shares = self._shares = Shares.of(samples, len(rows.flag), self._count(rows), self._group.size, block)
        self._group.order(Order.ITERATION, float(not self._config.shared))
        self._group.broadcast(self._state())
        others = [shares.rows(rank) for rank in range(1, shares.learners)]
        self._group.send([[torch.tensor([part.stop - part.start])] for part in others])
        self._group.send([_tensors(_part(rows, part)) for part in others])
        super()._load(_part(rows, shares.rows(0)))
        assert rows.log_probability is not None
        self._rows = {
            "action": torch.from_numpy(rows.action),
            "log_probability": torch.from_numpy(rows.log_probability),
        }

    def _all_values(self) -> Float32:
        self._group.order(Order.VALUES)
        own = super()._all_values()
        return np.concatenate([own, *(part.numpy() for part in self._answers())])

    def _newest_log_probability(self, rows: Rows) -> Tensor:
        self._group.order(Order.NEWEST)
        newest = super()._newest_log_probability(_part(rows, self._shares.rows(0)))
        for rank, part in enumerate(self._answers(), 1):
            newest[self._shares.rows(rank)] = part
        return newest

    def _answers(self) -> list[Tensor]:
        """Return what the others have computed of their rows, [rows, agents] each."""
        sizes = np.diff(self._shares.starts)[1:].tolist()
        found = [torch.zeros(size, self._team.agents) for size in sizes]
        for rank, part in enumerate(found, 1):
            self._group.receive([part], rank)
        return found

    def _send_computed(self) -> None:
        """Send the others what they learn from, and the networks as they are now."""
        self._group.order(Order.LEARN)
        self._group.broadcast(self._state())
        others = [self._shares.rows(rank) for rank in range(1, self._shares.learners)]
        self._group.send([[self._rows[name][part].contiguous() for name in LEARNT] for part in others])

    def minibatches(self, rows: Rows, random: np.random.Generator) -> list[NDArray[np.int64]]:
        """See `Updates`; each minibatch has equally many samples of every learner."""
        return self._shares.minibatches(random.permutation(self.samples(rows)), self._count(rows))

    def update(self, samples: NDArray[np.int64], progress: float) -> None:
        """See `Updates`."""
        parts = self._shares.split(samples)
        self._sizes = [len(part) for part in parts]
        stopped = sum(1 << kind for kind, has_stopped in enumerate(self.stopped) if has_stopped)
        self._group.order(Order.UPDATE, progress, float(stopped), *map(float, self._sizes))
        self._group.send([[torch.from_numpy(part)] for part in parts[1:]])
        super().update(parts[0], progress)

    def end(self) -> None:
        """See `Updates`."""
        self._group.order(Order.COMPARE)
        self._compare()
        super().end()


class FollowingUpdates(GroupUpdates):
    """A follower's updates: what the leader orders.

    Attributes:
        most_rows: most rows that an iteration has.
    """

    most_rows = 0

    @property
    def separate(self) -> bool:
        """Whether agents have networks of their own."""
        return not self._config.shared

    def parted(self) -> "FollowingUpdates":
        """Return the updates of separate networks."""
        found = self.separated()
        assert isinstance(found, FollowingUpdates)
        found.most_rows = self.most_rows
        return found

    def take_rows(self) -> None:
        """Get the networks and this learner's rows, and prepare them."""
        self._group.broadcast(self._state())
        size = torch.zeros(1, dtype=torch.int64)
        self._group.receive([size])
        count = self._checked(int(size), self.most_rows)
        team = self._team
        kind = observation_type(team, rounded=self._config.bfloat16_observations)
        self._part = Rows(
            np.zeros((count, team.observation_size), kind),
            np.zeros((count, team.action_size), np.float32),
            np.zeros((count, 0), np.float32),
            np.zeros(count, np.uint8),
            np.zeros((count, team.agents), np.float32),
        )
        self._group.receive(_tensors(self._part))
        self._load(self._part)

    def send_values(self) -> None:
        """Send the leader V of each row."""
        self._group.answer(torch.from_numpy(self._all_values()))

    def send_newest(self) -> None:
        """Send the leader the present actors' log-probabilities of each row."""
        self._group.answer(self._newest_log_probability(self._part).contiguous())

    def take_computed(self) -> None:
        """Get what the leader has computed for this learner's rows, and the networks once more."""
        self._group.broadcast(self._state())
        self._rows |= {name: torch.zeros(len(self._part.flag), self._team.agents) for name in LEARNT}
        self._group.receive([self._rows[name] for name in LEARNT])

    def follow_update(self, ordered: Ordered) -> None:
        """Do the leader's update from this learner's part of its minibatch."""
        progress, stopped, *sizes = ordered.numbers
        self._sizes, rows = [int(size) for size in sizes], len(self._part.flag)
        own = self._checked(self._sizes[self._group.rank], rows)
        samples = torch.zeros(own, dtype=torch.int64)
        self._group.receive([samples])
        if own and not 0 <= int(samples.min()) <= int(samples.max()) < rows:
            raise GroupError(f"learner {self._group.rank} of {self._group.size} got samples that it has not.")
        self.stopped = [bool(int(stopped) >> kind & 1) for kind in range(len(self._team.groups))]
        self._learn(self._minibatch(samples.numpy(), progress))

    def compare(self) -> None:
        """Compare the networks with the leader's, and forget the rows."""
        self._compare()
        self.end()

    def _checked(self, count: int, most: int) -> int:
        if not 0 <= count <= most:
            raise GroupError(f"learner {self._group.rank} of {self._group.size} got an impossible count, {count}.")
        return count


def _measured(*, stopped: bool) -> tuple[str, ...]:
    return VALUES if stopped else (*ACTORS, *VALUES)


def _part(rows: Rows, part: slice) -> Rows:
    """Return some of the rows, without their rewards, which the leader alone needs."""
    assert rows.log_probability is not None
    nothing = np.zeros((part.stop - part.start, 0), np.float32)
    columns = rows.observation[part], rows.action[part], nothing, rows.flag[part]
    return Rows(*columns, rows.log_probability[part])


def _tensors(rows: Rows) -> Sequence[Tensor]:
    """Return what travels of some rows, as tensors that share its memory; bfloat16 numbers as bytes."""
    assert rows.log_probability is not None
    arrays = rows.observation, rows.action, rows.flag, rows.log_probability
    found = [as_tensor(np.ascontiguousarray(array)) for array in arrays]
    return [tensor.view(torch.uint8) if tensor.dtype == torch.bfloat16 else tensor for tensor in found]
