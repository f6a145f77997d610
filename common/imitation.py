"""Elite imitation: when events are due, and what an event contains.

Everything about event number e follows from e and the configuration, so a restarted coordinator continues from the
learner's count of applied events.
"""

from dataclasses import dataclass, replace
from typing import Final

from eia_sec.common.config import EliteConfig, RunConfig
from eia_sec.common.errors import SchemaError
from eia_sec.common.team import TeamSpec

LEASE_SECONDS: Final = 3.0
"""Time after the leading coordinator's last claim from which the learner lets another one lead."""
MOST_STEPS: Final = 2**48
"""Most environment steps of an evaluation."""


@dataclass(frozen=True)
class ImitationSchedule:
    """The decay of vartheta and the growth of delta, Algorithm 1 with reading A1.

    Attributes:
        config: the settings.
        enabled: whether agents imitate elites at all.
        since: episodes that were finished when agents got actors of their own; None while they share their type's.
    """

    config: EliteConfig
    enabled: bool = True
    since: int | None = 0

    @classmethod
    def of(cls, config: RunConfig) -> "ImitationSchedule":
        """Return a run's schedule; in an algorithm without imitation no event is ever due."""
        return cls(config.elite, config.imitates)

    def after(self, since: int | None) -> "ImitationSchedule":
        """Return the schedule that begins when agents get actors of their own; see `since`."""
        return replace(self, since=since)

    def rate(self, event: int) -> float:
        """Return vartheta of event number `event` (1 is the first)."""
        return self.config.rate * self.config.rate_decay ** (event - 1)

    def cycle(self, event: int) -> int:
        """Return the cycle delta that precedes event number `event`, episodes."""
        return max(1, round(self.config.cycle * self.config.cycle_growth ** (event - 1)))

    def due_episode(self, event: int) -> int | None:
        """Return the episode lambda at which event number `event` falls due, or None when it never does."""
        if not (self.enabled and self.config.enabled) or self.since is None:
            return None
        episode = self.since
        for number in range(1, event + 1):
            cycle = self.cycle(number)
            episode = (episode // cycle + 1) * cycle
        return episode

    def is_due(self, applied: int, episodes: int) -> bool:
        """Return whether, after `applied` events, the next one is due at `episodes` finished episodes."""
        due = self.due_episode(applied + 1)
        return due is not None and episodes >= due


@dataclass(frozen=True)
class ImitationEvent:
    """One soft-imitation update of all types, eq. (soft).

    Attributes:
        event: its number; 1 is the first.
        version: the parameter version that was evaluated.
        episode: the learner's count of finished episodes when the event fell due.
        rate: vartheta.
        elites: for each type, the elite's index inside the type.
        scores: for each type, omega of each agent, eq. (er).
        evaluation_steps: environment steps spent on the evaluation; they count in the run's budget (A3).
    """

    event: int
    version: int
    episode: int
    rate: float
    elites: tuple[int, ...]
    scores: tuple[tuple[float, ...], ...]
    evaluation_steps: int = 0

    def check(self, team: TeamSpec) -> None:
        """Raise SchemaError unless the event fits the team."""
        if self.event < 1 or not 0.0 <= self.rate <= 1.0:
            raise SchemaError(f"imitation event {self.event} with rate {self.rate} is impossible.")
        if not 0 <= self.evaluation_steps <= MOST_STEPS:
            raise SchemaError(f"an evaluation of {self.evaluation_steps} steps is impossible.")
        if len(self.elites) != len(team.groups) or len(self.scores) != len(team.groups):
            raise SchemaError("the imitation event is for another number of types.")
        for group, elite, scores in zip(team.groups, self.elites, self.scores, strict=True):
            if not 0 <= elite < group.count or len(scores) != group.count:
                raise SchemaError(f"the imitation event does not fit {group.count} {group.name} agents.")
