"""Watches over calls of a user's environment that do not return."""

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Final, NoReturn

from eia_sec.common.log import log
from eia_sec.rollout.envs.guard import Guard, end_process

PERIOD_SECONDS: Final = 1.0
ALARM_SECONDS: Final = (10, 60, 600, 3600)
"""Times after which a call that has not returned is said; each has a sentence of its own."""
STUCK_SECONDS: Final = 10.0
"""Time that a call may take once the process should end; its supervisor kills it after 8 s, if there is one."""
PICTURE_SECONDS: Final = 30.0
"""Time after which a call for people who watch, which nothing could interrupt, ends the process whatever its limit."""


class Watchdog:
    """A thread that speaks for its process while the main thread is inside a user's code.

    Args:
        limit: seconds after which it ends the process because a call has not returned; 0 for none.
        speak: called every second of a call that takes longer than that, from this thread.
        ends: whether the process should end.
        timed_out: called before the process ends because of the limit.

    Attributes:
        speak, timed_out: as given; may be replaced.
    """

    def __init__(
        self,
        limit: float,
        speak: Callable[[], None],
        ends: Callable[[], bool] = lambda: False,
        timed_out: Callable[[], None] = lambda: None,
    ) -> None:
        self.speak, self.timed_out = speak, timed_out
        self._limit, self._ends = limit, ends
        self._closed = threading.Event()
        self._ending_since: float | None = None
        self._thread = threading.Thread(target=self._run, name="watchdog", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._closed.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._closed.wait(PERIOD_SECONDS):
            running, now = Guard.running, time.monotonic()
            if self._ends() and self._ending_since is None:
                self._ending_since = now
            if running is None or running.seconds < PERIOD_SECONDS:
                continue
            self.speak()
            told = f"{running.environment} has been in {running.method} for {running.seconds:.0f} s"
            if running.for_watchers and running.seconds > PICTURE_SECONDS:
                self.timed_out()
                _leave(f"{told}, for somebody who watches; this process ends.")
            if 0.0 < self._limit < running.seconds:
                self.timed_out()
                _leave(f"{told}, longer than env.step_timeout {self._limit:g}; this process ends.")
            if self._ending_since is not None and now - max(self._ending_since, running.since) > STUCK_SECONDS:
                _leave(f"{told}, and is not waited for any longer; this process ends.")


@contextmanager
def watched(limit: float) -> Iterator[None]:
    """Log which call of a user's environment does not return in this block, and end the process after the limit."""
    said = [""]

    def speak() -> None:
        if (text := call_alarm()) and text != said[0]:
            said[0] = text
            log(text)

    with closing(Watchdog(limit, speak)):
        yield


def call_alarm() -> str:
    """Return a sentence about a call that has not returned for one of ALARM_SECONDS, or an empty string."""
    running = Guard.running
    passed = [] if running is None else [limit for limit in ALARM_SECONDS if running.seconds >= limit]
    return f"{running.environment} has been in {running.method} for {passed[-1]} s." if running and passed else ""


def _leave(sentence: str) -> NoReturn:
    """End this process, whose main thread cannot, and the processes that its environments have started."""
    log(sentence)
    if os.getpgrp() == os.getpid():  # as a supervisor starts it; else others are in the group
        os.killpg(0, signal.SIGTERM)  # this process only notes it
    end_process(1)
