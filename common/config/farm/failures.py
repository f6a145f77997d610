"""UAVs that fail in flight, drawn or given, and UAVs that are missing from the start."""

import re
from dataclasses import dataclass
from typing import Final, NamedTuple

from eia_sec.common.config.checks import within
from eia_sec.common.errors import ConfigError

KINDS: Final = ("communication", "monitoring", "collection")
"""Names of the types, in row order."""
MOST_PER_HOUR: Final = 1e6
"""Most failures per UAV and hour of flight."""
_GIVEN: Final = re.compile(rf"({'|'.join(KINDS)}) (\d{{1,9}}) at (\d{{1,9}})")


class GivenFailure(NamedTuple):
    """A failure that the configuration names.

    Attributes:
        kind: type of the UAV, an index of KINDS.
        rank: index of the UAV within its type.
        step: first step of which the UAV is no part.
    """

    kind: int
    rank: int
    step: int


@dataclass(frozen=True)
class FailureConfig:
    """UAVs that fail in flight or are missing from the start; without, nothing changes."""

    per_hour: float = 0.0
    """Expected failures per UAV and hour of flight; 0 for none (ours)."""
    at: str = ""
    """Given failures: type, index within the type and first step without the UAV, separated by commas; for instance
    "monitoring 2 at 120, communication 0 at 300" (ours)."""
    missing: float = 0.0
    """Probability that a UAV is missing from the first step on, which makes teams of random sizes; of each type one at
    least is there (ours)."""

    def __post_init__(self) -> None:
        """Refuse rates and probabilities that are none, and failures that cannot be read."""
        within(0.0, MOST_PER_HOUR, per_hour=self.per_hour)
        within(0.0, 1.0, missing=self.missing)
        self.given()

    @property
    def some(self) -> bool:
        """Whether any UAV can be gone."""
        return self.in_flight or self.missing > 0.0

    @property
    def in_flight(self) -> bool:
        """Whether any UAV can fail."""
        return self.per_hour > 0.0 or bool(self.at.strip())

    def given(self) -> tuple[GivenFailure, ...]:
        """Return the given failures; raise ConfigError if they cannot be read."""
        found = []
        for text in self.at.split(",") if self.at.strip() else ():
            match = _GIVEN.fullmatch(" ".join(text.split()))
            if match is None:
                raise ConfigError(
                    f"failures.at must be like 'monitoring 2 at 120, communication 0 at 300', not {self.at[:80]!r}."
                )
            found.append(GivenFailure(KINDS.index(match[1]), int(match[2]), int(match[3])))
        return tuple(found)

    def check(self, counts: tuple[int, int, int], steps: int) -> None:
        """Refuse failures of UAVs and in steps that there are not.

        Args:
            counts: number of UAVs of each type.
            steps: of an episode.

        Raises:
            ConfigError: a given failure names no UAV or no step.
        """
        for kind, rank, step in self.given():
            name = f"failures.at names {KINDS[kind]} {rank} at {step}"
            if rank >= counts[kind]:
                raise ConfigError(f"{name}, but {KINDS[kind]} UAVs are numbered 0 to {counts[kind] - 1}.")
            if not 1 <= step <= steps:
                raise ConfigError(f"{name}, but steps are numbered 1 to {steps}.")
