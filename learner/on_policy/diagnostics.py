"""What the updates of the newest iteration measured, by type of agent.

    actor_loss           PPO's surrogate loss with the entropy bonus
    value_loss           mean((V - R)^2) over agents; with an ensemble, plus the sum of that over its members
    entropy              mean entropy of the policies, nats
    kl                   KL divergence from the policy that `objective` names to the actors
    clipped_share        share of samples whose ratio was clipped
    explained_variance   1 - Var(R - V) / Var(R) with the values at the iteration's start
    return_mean          mean R
    actor_gradient       Euclidean norm of the gradient of the type's actors, before any clip
    value_gradient       the same of its value functions

All but the first iteration report means over the updates of the last whole iteration, so that numbers do not jump.
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import torch
from torch import Tensor

from eia_sec.common.errors import CheckpointError
from eia_sec.common.team import Float32, TeamSpec
from eia_sec.learner.checkpoint.trainer_state import counter, finite

NAMES: Final = (
    "actor_loss",
    "value_loss",
    "entropy",
    "kl",
    "clipped_share",
    "explained_variance",
    "return_mean",
    "actor_gradient",
    "value_gradient",
)


class Mean:
    """A mean of numbers that come one by one.

    Attributes:
        total: their sum.
        count: how many there are.
    """

    def __init__(self, total: float = 0.0, count: int = 0) -> None:
        self.total, self.count = total, count

    def add(self, number: float) -> None:
        """Add a number."""
        self.total, self.count = self.total + number, self.count + 1

    @property
    def value(self) -> float:
        """The mean; 0 without a number."""
        return self.total / max(1, self.count)


class IterationDiagnostics:
    """Means over an iteration's updates.

    Args:
        team: the layout of the team.

    Attributes:
        newest: the means of the last whole iteration, as NAME/TYPE.
    """

    def __init__(self, team: TeamSpec) -> None:
        self._groups = list(zip(team.groups, team.agent_slices(), strict=True))
        self._means: list[dict[str, Mean]] = [{} for _ in self._groups]
        self._epoch = [Mean() for _ in self._groups]
        self._unread: list[list[dict[str, Tensor]]] = []
        self.newest: dict[str, float] = {}

    def begin(self, value: Float32, returns: Float32) -> None:
        """Start an iteration with the values and returns [steps, agents] of its steps."""
        self._means = [{} for _ in self._groups]
        self._epoch = [Mean() for _ in self._groups]
        self._unread = []
        for means, (_, agents) in zip(self._means, self._groups, strict=True):
            own, error = returns[:, agents], returns[:, agents] - value[:, agents]
            variance = float(own.var())
            means["explained_variance"] = Mean(1.0 - float(error.var()) / variance if variance > 0.0 else 0.0, 1)
            means["return_mean"] = Mean(float(own.mean()), 1)

    def add(self, measured: Sequence[Mapping[str, Tensor]]) -> None:
        """Add an update: what was measured of each type, by NAMES; nothing about actors that have stopped."""
        self._unread.append([dict(found) for found in measured])

    def _read(self) -> None:
        """Count what was added; a GPU's numbers come at once, because each reading waits for its updates."""
        numbers = [number for update in self._unread for found in update for number in found.values()]
        values = iter(torch.stack(numbers).tolist() if numbers else [])
        for update in self._unread:
            for means, epoch, found in zip(self._means, self._epoch, update, strict=True):
                for name in found:
                    means.setdefault(name, Mean()).add(value := next(values))
                    if name == "kl":
                        epoch.add(value)
        self._unread = []

    def epoch_kl(self) -> list[float]:
        """Return each type's mean KL divergence over the epoch, and begin another epoch; 0 for stopped actors."""
        self._read()
        found = [mean.value for mean in self._epoch]
        self._epoch = [Mean() for _ in self._groups]
        return found

    def end(self) -> None:
        """Finish the iteration: its means are reported from now on."""
        self._read()
        self.newest = {
            f"{name}/{group.name}": means[name].value
            for name in NAMES
            for means, (group, _) in zip(self._means, self._groups, strict=True)
            if name in means
        }

    def state(self) -> dict[str, Any]:
        """Return everything as plain values, from which `restore` continues."""
        self._read()
        return {
            "means": [{name: [mean.total, mean.count] for name, mean in means.items()} for means in self._means],
            "epoch": [[mean.total, mean.count] for mean in self._epoch],
            "newest": self.newest,
        }

    def restore(self, state: Any) -> None:
        """Continue from `state`; if any part does not fit, change nothing and raise CheckpointError."""
        try:
            means = [{_known(name): _mean(entry) for name, entry in part.items()} for part in state["means"]]
            epoch = [_mean(entry) for entry in state["epoch"]]
            newest = {str(name): finite(state["newest"], name) for name in state["newest"]}
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise CheckpointError(f"the checkpoint's diagnostics are not readable: {error}.") from error
        if len(means) != len(self._groups) or len(epoch) != len(self._groups):
            raise CheckpointError("the checkpoint's diagnostics are of another team.")
        self._means, self._epoch, self._unread, self.newest = means, epoch, [], newest


def _known(name: str) -> str:
    if name not in NAMES:
        raise ValueError(f"{name!r} is unknown"[:80])
    return name


def _mean(entry: Any) -> Mean:
    total, count = entry
    return Mean(finite({"total": total}, "total"), counter({"count": count}, "count"))
