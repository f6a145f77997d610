"""Time, chance and processes of a simulated run: one heap of events, one generator of random numbers.

A process is a set of loops (`eia_sec.common.loops`) that take their steps in turn. Whatever happens, happens at a
moment that the seed has drawn, so a seed always leads to the same events.
"""

import heapq
import random
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import count
from typing import Any

LEAST_PAUSE = 0.05
"""Shortest simulated pause of a loop: a machine may always be slower than a loop asks."""
DAY = 86_400.0
BEGIN = 1_700_000_000.0
"""The time of day at which a simulation begins, seconds since 1970."""


class Killed(BaseException):
    """The process was killed in the middle of something."""


@dataclass(eq=False)
class Process:
    """One start of a process.

    Attributes:
        name: unique among all starts.
        node: the machine on which it runs, which keeps its name over starts.
        alive: whether it has neither ended nor been killed.
        frozen_until: it takes no steps before this time.
        busy_until: it computes until then.
        wall: seconds by which its machine's clock is ahead.
        fuse: steps of input and output after which it is killed, or None.
        ended: why it ended, once it has: empty as intended, else the error.
        parts: its objects, for the judge.
    """

    name: str
    node: str
    alive: bool = True
    frozen_until: float = 0.0
    busy_until: float = 0.0
    wall: float = 0.0
    fuse: int | None = None
    ended: str | None = None
    parts: dict[str, Any] = field(default_factory=dict)
    loops: list[Generator[float, None, Any]] = field(default_factory=list)


class World:
    """The clock and the events of one simulation; it is also the clock that the product reads.

    Attributes:
        now: simulated seconds.
        draw: the source of all chance.
        trace: what happened, in order.
        current: the process whose step is being taken.
    """

    def __init__(self, seed: int) -> None:
        self.now = 1000.0
        self.draw = random.Random(seed)
        self.trace: list[str] = []
        self.events = 0
        self.current: Process | None = None
        self.pace = self.draw.choice((1.0, 3.0, 6.0))
        self.on_death: list[Callable[[Process], None]] = []
        self._heap: list[tuple[float, int, Callable[[], None]]] = []
        self._order = count()

    def monotonic(self) -> float:
        """Return the seconds that the product reads."""
        return self.now

    def time_ns(self) -> int:
        """Return the time of day of the current process's machine."""
        ahead = self.current.wall if self.current is not None else 0.0
        return int((BEGIN + self.now + ahead) * 1e9)

    def note(self, text: str) -> None:
        """Write down what happens."""
        self.trace.append(f"{self.now - 1000.0:9.3f} {text}")

    def after(self, seconds: float, event: Callable[[], None]) -> None:
        """Let something happen in so many seconds."""
        heapq.heappush(self._heap, (self.now + seconds, next(self._order), event))

    def start(self, process: Process, loop: Generator[float, None, Any]) -> None:
        """Let a process take the steps of a loop, from now on."""
        process.loops.append(loop)
        self.after(0.0, lambda: self._step(process, loop))

    def run(self, until: float, over: Callable[[], bool]) -> None:
        """Let events happen until a time, or until it is over."""
        while self._heap and self._heap[0][0] < until and not over():
            self.now, _, event = heapq.heappop(self._heap)
            self.events += 1
            event()
        if not over():
            self.now = max(self.now, until)

    def kill(self, process: Process, why: str) -> None:
        """End a process without a last word."""
        if process.alive:
            process.alive, process.ended = False, f"killed: {why}"
            self.note(f"{process.name} is killed: {why}")
            for told in self.on_death:
                told(process)

    def _step(self, process: Process, loop: Generator[float, None, Any]) -> None:
        if not process.alive:
            return
        wait = max(process.frozen_until, process.busy_until) - self.now
        if wait > 0.0:
            self.after(wait, lambda: self._step(process, loop))
            return
        self.current = process
        try:
            pause = next(loop)
        except StopIteration:
            if loop is process.loops[0]:
                self._end(process, "")
            return
        except Killed as killed:
            self.kill(process, str(killed))
            return
        except Exception as error:
            self._end(process, f"{type(error).__name__}: {error}", error)
            return
        finally:
            self.current = None
        pause = max(pause, LEAST_PAUSE) * self.draw.uniform(1.0, self.pace) if pause > 0.0 else 1e-4
        self.after(pause, lambda: self._step(process, loop))

    @contextmanager
    def as_process(self, process: Process) -> Iterator[None]:
        """Act for a process beside its loops, as one of its threads does."""
        self.current = process
        try:
            yield
        except Killed as killed:
            self.kill(process, str(killed))
        finally:
            self.current = None

    def _end(self, process: Process, why: str, error: Exception | None = None) -> None:
        process.alive, process.ended = False, why
        process.parts["error"] = error
        self.note(f"{process.name} ends{': ' + why if why else ''}")
        for told in self.on_death:
            told(process)
