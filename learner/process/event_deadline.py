"""How late imitation events are, and how long new experience waits for them.

A free-running learner does not wait for the coordinator, so it applies an event some episodes after it falls due. With
a fast environment, or while a coordinator starts, the delay can grow until a run ends without any imitation. So once an
event is a whole cycle late, the learner accepts no new experience until the event arrives or HOLD_SECONDS have passed.
"""

from typing import Final

from eia_sec.common.imitation import ImitationSchedule

HOLD_SECONDS: Final = 20.0
"""Longest wait for one event; less than the time after which workers send a request again."""

ALARM_SECONDS: Final = 5.0
"""Time for which an event may be a cycle late before it raises an alarm."""


class EventDeadline:
    """Watches the imitation events of one run.

    Args:
        schedule: when events fall due.
    """

    def __init__(self, schedule: ImitationSchedule) -> None:
        self._schedule = schedule
        self._counted: tuple[int, int | None] | None = None
        self._late = 0
        self._due: int | None = None
        self._since: float | None = None
        self._looked: float | None = None
        self._waited = 0.0

    def holds(self, applied: int, episodes: int, since: int | None, *, expected: bool, now: float) -> bool:
        """Return whether new experience must wait for the next event.

        Args:
            applied: events applied.
            episodes: finished episodes, lambda.
            since: finished episodes when agents got actors of their own; None while they share them.
            expected: whether a coordinator is present or will come.
            now: a monotonic clock, seconds.
        """
        late = self._lateness(applied, episodes, since, now)
        return expected and 0.0 <= late < HOLD_SECONDS

    def alarm(self, applied: int, episodes: int, since: int | None, *, able: bool, now: float) -> str:
        """Return a sentence if an event has been a cycle late for some time, else "".

        Args:
            applied: events applied.
            episodes: finished episodes, lambda.
            since: finished episodes when agents got actors of their own; None while they share them.
            now: a monotonic clock, seconds.
            able: whether the learner can apply an event now; time between two calls counts where it can at both.
        """
        late = self._lateness(applied, episodes, since, now)
        if late < 0.0:
            self._waited = 0.0
        elif able and self._looked is not None:
            self._waited += min(late, now - self._looked)
        self._looked = now if able else None
        if self._waited < ALARM_SECONDS:
            return ""
        return (
            f"imitation event {applied + 1} was due at episode {self._due} and has not arrived; is a coordinator "
            "running?"
        )

    def _lateness(self, applied: int, episodes: int, since: int | None, now: float) -> float:
        """Return how many seconds the next event has been a cycle late, or -1 if it is not."""
        if self._counted != (applied, since):
            self._counted, self._since, self._waited = (applied, since), None, 0.0
            self._due = self._schedule.after(since).due_episode(applied + 1)
            self._late = 0 if self._due is None else self._due + self._schedule.cycle(applied + 1)
        if self._due is None or episodes < self._late:
            return -1.0
        self._since = now if self._since is None else self._since
        return now - self._since
