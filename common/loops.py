"""The loops of processes: generators that yield how many seconds they wait before their next step.

They hold no thread. A process runs them in its threads, with `run` and `in_thread`; a simulation takes their steps in
the order that its seed says. A pause of 0 only says that a step has ended.
"""

import threading
import time
from collections.abc import Generator
from typing import Generic, TypeVar

T = TypeVar("T")
Loop = Generator[float, None, T]


class Running(Generic[T]):
    """A loop whose steps its owner takes between other things.

    Attributes:
        result: what the loop returned, once `step` has returned True.
    """

    result: T

    def __init__(self, loop: Loop[T]) -> None:
        self._loop = loop
        self.pause = 0.0

    def step(self) -> bool:
        """Take the next step; return whether it was the last. Raises what the loop raises."""
        try:
            self.pause = next(self._loop)
        except StopIteration as end:
            self.result = end.value
            return True
        return False


def run(loop: Loop[T], woken: threading.Event | None = None) -> T:
    """Take all steps of a loop in this thread, and return its result.

    Args:
        loop: the loop.
        woken: ends a pause when it is set, and is cleared then.
    """
    running = Running(loop)
    while not running.step():
        if woken is None:
            time.sleep(running.pause)
        elif running.pause > 0.0:
            woken.wait(running.pause)
            woken.clear()
    return running.result


def in_thread(name: str, loop: Loop[None], woken: threading.Event | None = None) -> threading.Thread:
    """Start a thread that runs a loop, and return it."""
    thread = threading.Thread(target=run, args=(loop, woken), name=name, daemon=True)
    thread.start()
    return thread
