"""Running scales: observations as networks read them, and returns as value functions learn them.

    x' = (x - m) / s             m, s of each number of a type's observations, over all rows so far
    R' = (R - m_R) / s_R         m_R, s_R of a type's returns, over the newest iterations

Both change once an iteration, at its start. Networks then keep their function: first layers take up what m and s have
moved by, last layers of value functions what m_R and s_R have (PopArt, van Hasselt et al. 2016). Published actors have
the first line folded into their first layer, so whoever acts with them reads observations as they are.

A plug-in's networks read what has moved as it is. For them m and s change at an iteration's end, so that actors learn
from the inputs that they acted on.
"""

from collections.abc import Iterator, Mapping
from typing import Final

import torch
from torch import Tensor

from eia_sec.common.errors import CheckpointError
from eia_sec.common.team import GroupSpec, TeamSpec

LARGEST: Final = 10.0
"""Distance from the mean, in scales, of the number that lies farthest from it: a number that is rarely not 0 would else
become a large one."""
MOST_ROWS: Final = 1e7
"""Rows after which older ones begin to count less, so that scales follow what changes."""
KEPT: Final = 0.9
"""Share of what is known of returns that is left after another iteration."""
SMALLEST: Final = 1e-6
"""Least deviation of returns by which they are divided."""


class ObservationScale:
    """The running scale of one type's observations.

    Args:
        group: the type. Its masks of legal actions are not scaled, and images not at all.

    Attributes:
        tensors: float64 by name: rows seen [1], then mean, deviation, least and largest of each number, [o] each, or
            [0] of images.
    """

    def __init__(self, group: GroupSpec) -> None:
        self._size = group.observation_size
        self._scaled = 0 if group.image else self._size - (group.options if group.masked else 0)
        size = 0 if group.image else self._size
        zeros = {name: torch.zeros(size, dtype=torch.float64) for name in ("mean", "deviation", "least", "largest")}
        self.tensors = {"rows": torch.zeros(1, dtype=torch.float64), **zeros}

    def add(self, observations: Tensor) -> None:
        """Take in observations [N, o]."""
        t, count = self.tensors, torch.tensor([float(len(observations))], dtype=torch.float64)
        rows = t["rows"]
        if not self._scaled:
            rows.copy_(torch.clamp(rows + count, max=MOST_ROWS))
            return
        new = observations.double()
        share = count / (rows + count)
        shift = new.mean(dim=0) - t["mean"]
        variance = (1.0 - share) * t["deviation"] ** 2 + share * new.var(dim=0, unbiased=False)
        variance += share * (1.0 - share) * shift**2
        least, largest = new.amin(dim=0), new.amax(dim=0)
        if float(rows):
            least, largest = torch.minimum(least, t["least"]), torch.maximum(largest, t["largest"])
        found = (torch.clamp(rows + count, max=MOST_ROWS), t["mean"] + share * shift, variance.sqrt(), least, largest)
        for name, tensor in zip(("rows", "mean", "deviation", "least", "largest"), found, strict=True):
            t[name].copy_(tensor)

    def shift_and_scale(self) -> tuple[Tensor, Tensor]:
        """Return m and s, [o] float32; 0 and 1 for masks, for numbers that never change, and before the first rows."""
        t, kept = self.tensors, self._scaled
        if not kept:
            return torch.zeros(self._size), torch.ones(self._size)
        farthest = torch.maximum(t["largest"] - t["mean"], t["mean"] - t["least"])
        scale = torch.maximum(t["deviation"], farthest / LARGEST)
        shift, scale = t["mean"].clone(), torch.where(scale > 0.0, scale, 1.0)
        shift[kept:], scale[kept:] = 0.0, 1.0
        return shift.float(), scale.float()


class ReturnScale:
    """The running scale of one type's returns.

    Attributes:
        tensors: float64 [1] by name: weight of what is known, mean, and deviation.
    """

    def __init__(self) -> None:
        self.tensors = {name: torch.zeros(1, dtype=torch.float64) for name in ("weight", "mean", "deviation")}

    @property
    def fresh(self) -> bool:
        """Whether there were no returns yet."""
        return not float(self.tensors["weight"])

    def add(self, returns: Tensor) -> None:
        """Take in an iteration's returns, of any shape."""
        t, new = self.tensors, returns.double()
        weight = KEPT * t["weight"] + 1.0
        share, shift = 1.0 / weight, new.mean() - t["mean"]
        variance = (1.0 - share) * t["deviation"] ** 2 + share * new.var(unbiased=False)
        variance += share * (1.0 - share) * shift**2
        t["mean"].add_(share * shift)
        t["deviation"].copy_(variance.sqrt())
        t["weight"].copy_(weight)

    def shift_and_scale(self) -> tuple[float, float]:
        """Return m_R and s_R; 0 and 1 before the first returns."""
        t = self.tensors
        return float(t["mean"]), max(float(t["deviation"]), SMALLEST) if not self.fresh else 1.0


class Scales:
    """All running scales of a team.

    Args:
        team: the layout of the team.
        device: torch device of the networks.

    Attributes:
        observations: of each type.
        returns: of each type.
        loaded: [1], 1 if actors came from elsewhere before the first rows, and so must keep their function.
    """

    def __init__(self, team: TeamSpec, device: str) -> None:
        self._team, self._device = team, device
        self.observations = [ObservationScale(group) for group in team.groups]
        self.returns = [ReturnScale() for _ in team.groups]
        self.loaded = torch.zeros(1, dtype=torch.float64)

    @property
    def fresh(self) -> bool:
        """Whether there were no rows yet."""
        return not float(self.observations[0].tensors["rows"])

    def of_type(self, kind: int) -> tuple[Tensor, Tensor]:
        """Return m and s [o] of a type's observations."""
        shift, scale = self.observations[kind].shift_and_scale()
        return shift.to(self._device), scale.to(self._device)

    def of_team(self) -> tuple[Tensor, Tensor]:
        """Return m and s [O] of all agents' observations."""
        pairs = zip(self._team.groups, self.observations, strict=True)
        parts = [part.repeat(group.count) for group, own in pairs for part in own.shift_and_scale()]
        return torch.cat(parts[::2]).to(self._device), torch.cat(parts[1::2]).to(self._device)

    def named_tensors(self) -> Iterator[tuple[str, Tensor]]:
        """Yield all statistics by name; writing to them restores a state."""
        yield "loaded", self.loaded
        for group, seen, learnt in zip(self._team.groups, self.observations, self.returns, strict=True):
            for what, tensors in (("observations", seen.tensors), ("returns", learnt.tensors)):
                yield from ((f"{what}.{group.name}.{name}", tensor) for name, tensor in tensors.items())


def require_scales(found: Mapping[str, Tensor]) -> None:
    """Raise CheckpointError where a count, a weight or a deviation among a checkpoint's tensors is negative."""
    for name, tensor in found.items():
        counts = ".scales." in name and name.endswith((".rows", ".weight", ".deviation", ".loaded"))
        if counts and bool((tensor < 0.0).any()):
            raise CheckpointError(f"the checkpoint's {name} is negative.")
