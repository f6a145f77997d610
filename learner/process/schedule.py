"""When the learner does what: take in chunks, update, publish, report, write a checkpoint, finish.

Everything here is a function of the trainer's counters and of the clock readings that the caller passes in. The rule
for how many updates are due, and how far collection may lead them, is `updates_due` and `leads` of the trainer.
"""

from typing import Final, Protocol

from eia_sec.common.clock import monotonic
from eia_sec.common.config import RunConfig
from eia_sec.common.imitation import ImitationSchedule
from eia_sec.learner.process.event_deadline import EventDeadline

PROGRESS_SECONDS: Final = 0.1
REPORT_SECONDS: Final = 1.0


class Counters(Protocol):
    """The counters of a trainer that decisions depend on."""

    episodes: int
    events: int
    separate_since: int | None

    @property
    def between_iterations(self) -> bool:
        """Whether an imitation event can be applied."""

    @property
    def progress(self) -> float:
        """The finished share of the run, 0 to 1."""

    def updates_due(self) -> int:
        """Return how many updates are due."""

    def leads(self) -> bool:
        """Return whether collection is so far ahead of updates that workers must wait."""

    @property
    def burst(self) -> int:
        """Most updates between two polls for incoming messages."""


class Periodic:
    """A task that is due once per period.

    Args:
        seconds: the period.
        now: a monotonic clock, seconds; the first period begins here.
    """

    def __init__(self, seconds: float, now: float) -> None:
        self.seconds, self._last = seconds, now

    def due(self, now: float) -> bool:
        """Return whether the period has passed since the last restart."""
        return now - self._last >= self.seconds

    def restart(self, now: float) -> None:
        """Begin a new period."""
        self._last = now


class Schedule:
    """The learner's decisions about its next step.

    Args:
        config: the run.
        await_elite: whether late imitation events hold back new experience even before a coordinator has connected.
        now: a monotonic clock, seconds.

    Attributes:
        publish_timer: when parameters are published.
        progress_timer: when progress is published.
        report_timer: when metrics are reported.
        checkpoint_timer: when a checkpoint is written.
        deadline: how late imitation events are.
    """

    def __init__(self, config: RunConfig, *, await_elite: bool = False, now: float | None = None) -> None:
        now = monotonic() if now is None else now
        self._await_elite = await_elite
        self._imitation = ImitationSchedule.of(config)
        self.publish_timer = Periodic(config.learner.publish_seconds, now)
        self.progress_timer = Periodic(PROGRESS_SECONDS, now)
        self.report_timer = Periodic(REPORT_SECONDS, now)
        self.checkpoint_timer = Periodic(config.learner.checkpoint_seconds, now)
        self.deadline = EventDeadline(self._imitation)

    def finished(self, counters: Counters) -> bool:
        """Return whether the run has all its experience and no update is due."""
        return counters.progress >= 1.0 and counters.updates_due() <= 0

    def updates(self, counters: Counters) -> int:
        """Return how many updates to do before the next poll for incoming messages."""
        return max(0, min(counters.updates_due(), counters.burst))

    def takes_in(self, counters: Counters, *, awaits_event: bool) -> bool:
        """Return whether another chunk may enter replay before the next update."""
        return counters.progress < 1.0 and not (counters.leads() or awaits_event)

    def awaits_event(self, counters: Counters, *, has_coordinator: bool, now: float) -> bool:
        """Return whether new experience waits for a late imitation event (free-running)."""
        expected = self._await_elite or has_coordinator
        return self.deadline.holds(
            counters.events, counters.episodes, counters.separate_since, expected=expected, now=now
        )

    def event_due(self, counters: Counters) -> bool:
        """Return whether an imitation event is due now (lockstep)."""
        return self._imitation.after(counters.separate_since).is_due(counters.events, counters.episodes)

    def event_alarm(self, counters: Counters, now: float) -> str:
        """Return a sentence about an imitation event that is late, or an empty string."""
        able, since = counters.between_iterations, counters.separate_since
        return self.deadline.alarm(counters.events, counters.episodes, since, able=able, now=now)
