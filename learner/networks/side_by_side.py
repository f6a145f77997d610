"""Tasks that compute side by side, each in one thread.

The networks of an on-policy learner are small: one product divided among cores takes longer than on one. But the six
networks of three types do not depend on each other. Each keeps its arithmetic in one thread, so that results are the
same with any number of threads. Threads that wait sleep, so that workers get the core.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from typing import TypeVar

import torch

Result = TypeVar("Result")


class SideBySide:
    """A pool of threads for tasks that do not depend on each other.

    Args:
        threads: how many compute at once; with 1 the caller computes everything itself.
    """

    def __init__(self, threads: int) -> None:
        self._pool = None if threads == 1 else ThreadPoolExecutor(threads, "updates", _prepare)

    def run(self, tasks: Sequence[Callable[[], Result]]) -> list[Result]:
        """Return the results of all tasks, in their order; the first ones begin first.

        When a task raises, the others still end before that reaches the caller.
        """
        if self._pool is None:
            return [task() for task in tasks]
        futures = [self._pool.submit(task) for task in tasks]
        wait(futures)
        return [future.result() for future in futures]


def _prepare() -> None:
    """Flush numbers below 1e-38 to 0, which each thread does for itself; see `learner.trainer.flushed_denormals`."""
    torch.set_flush_denormal(True)
