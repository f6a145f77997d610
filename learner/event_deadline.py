"""How late imitation events are, and for how long new experience waits for them.

A free-running learner takes no turns with the coordinator, so an event is applied a little after the episode at which
it falls due. On a fast environment, or while a coordinator starts or is replaced, that little grows until a run ends
without any imitation. From a whole cycle on the learner therefore takes in nothing more until the event has come.
"""

from typing import Final

from common.imitation import ImitationSchedule

HOLD_SECONDS: Final = 20.0
"""Longest wait for one event; shorter than workers wait for an answer, so that they send nothing twice."""

ALARM_SECONDS: Final = 5.0
"""Time for which an event may be late before anybody is told."""


class EventDeadline:
    """Watches one run's events.

    Args:
        schedule: when events fall due.
    """

    def __init__(self, schedule: ImitationSchedule) -> None:
        self._schedule = schedule
        self._applied, self._late = -1, 0
        self._due: int | None = None
        self._since: float | None = None

    def holds(self, applied: int, episodes: int, *, expected: bool, now: float) -> bool:
        """Return whether new experience is to wait for the next event.

        Args:
            applied: events applied.
            episodes: finished episodes, lambda.
            expected: whether there is, or will be, somebody who holds events.
            now: a monotonic clock, seconds.
        """
        late = self._lateness(applied, episodes, now)
        return expected and 0.0 <= late < HOLD_SECONDS

    def alarm(self, applied: int, episodes: int, now: float) -> str:
        """Return that an event has been a cycle late for some time, or nothing; arguments as those of `holds`."""
        if self._lateness(applied, episodes, now) < ALARM_SECONDS:
            return ""
        return (
            f"imitation event {applied + 1} was due at episode {self._due} and has not come; is a coordinator running?"
        )

    def _lateness(self, applied: int, episodes: int, now: float) -> float:
        """Return the seconds for which the next event has been a cycle late, or -1."""
        if applied != self._applied:
            self._applied, self._since = applied, None
            self._due = self._schedule.due_episode(applied + 1)
            self._late = 0 if self._due is None else self._due + self._schedule.cycle(applied + 1)
        if self._due is None or episodes < self._late:
            return -1.0
        self._since = now if self._since is None else self._since
        return now - self._since
