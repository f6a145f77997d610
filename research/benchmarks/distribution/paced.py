"""A cooperative task in real time: four vehicles line up between two marks, and a step lasts as long as theirs does.

`env.name` is `research.benchmarks.distribution.paced:parallel_env`. The task is MPE's simple_line. A step returns when
its period is over, as that of a vehicle or of a simulator in real time does, so an environment takes time but next to
no processor.
"""

import time
from collections.abc import Callable
from typing import Any

from mpe2 import simple_line_v1
from pettingzoo import ParallelEnv
from pettingzoo.utils import BaseParallelWrapper

PERIOD = 0.02
"""Seconds of a step."""


class Pacer:
    """Waits until a period has passed since it last returned.

    Who comes late begins a new period: a vehicle makes up for no time.

    Args:
        period: seconds.
        clock: returns monotonic seconds.
        sleep: sleeps for some seconds.
    """

    def __init__(
        self,
        period: float,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._period, self._clock, self._sleep = period, clock, sleep
        self._due = clock()

    def wait(self) -> None:
        """Return when the period is over."""
        self._due += self._period
        now = self._clock()
        if now < self._due:
            self._sleep(self._due - now)
        else:
            self._due = now


class PacedEnv(BaseParallelWrapper):  # type: ignore[type-arg]  # pettingzoo's wrapper has no arguments of type
    """An environment whose steps take real time.

    Args:
        env: what is paced.
        period: seconds of a step.
    """

    def __init__(self, env: ParallelEnv[Any, Any, Any], period: float) -> None:
        super().__init__(env)
        self._pacer = Pacer(period)

    def step(self, actions: dict[Any, Any]) -> Any:
        """Step; return when the period is over."""
        result = super().step(actions)
        self._pacer.wait()
        return result


def parallel_env(period: float = PERIOD, **keywords: Any) -> PacedEnv:
    """Return simple_line in real time.

    Args:
        period: seconds of a step.
        keywords: what MPE's environment takes.
    """
    return PacedEnv(simple_line_v1.parallel_env(**keywords), period)
