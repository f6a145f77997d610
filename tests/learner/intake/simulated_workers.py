"""Workers and a learner in simulated time around an `IterationRoom`: who flies when, and what comes too late."""

import heapq
import threading
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count

from eia_sec.common.protocol.codec import NO_LIMIT
from eia_sec.learner.intake.iteration_room import IterationRoom, Terms
from eia_sec.learner.intake.limits import IntakeLimits

TICK = 0.02
"""Seconds between two looks of the learner for messages."""
PROGRESS = 0.1
"""Seconds between two publications of the window."""


@dataclass
class Worker:
    """What a worker knows and does, as `CollectionGate` and `Sender` have it; two chunks fit into its spool."""

    name: str
    version: int = 1
    required: int = 0
    window: int = 1
    asked: int = NO_LIMIT
    answered: float = -1.0
    under_way: int = 0
    unanswered: int = 0
    flying: bool = False


class Simulation:
    """One run, in simulated time.

    Args:
        workers: number of workers.
        chunk: environment steps of a whole chunk.
        iteration: environment steps of an iteration.
        flight: seconds in which a whole chunk is flown.
        update: seconds in which an iteration's updates are done.
        most_lag: L.
        gone: a worker that leaves after its first chunk.
        least: environment steps of the shortest chunk, None for whole chunks only.

    Attributes:
        accepted: environment steps that are learned from.
        refused: environment steps that came too late.
    """

    def __init__(
        self,
        workers: int,
        chunk: int,
        iteration: int,
        flight: float,
        update: float,
        most_lag: int = 1,
        gone: int | None = None,
        least: int | None = None,
    ) -> None:
        self.now, self.accepted, self.refused = 0.0, 0, 0
        self.chunk, self.size, self.flight, self.update, self.gone = chunk, iteration, flight, update, gone
        self.gate = threading.Lock()
        self.room = IterationRoom(IntakeLimits(64, most_lag, iteration, chunk, least), 1, self.gate, lambda: self.now)
        self.workers = [Worker(str(index)) for index in range(workers)]
        self.version, self.number, self.updating = 1, 0, False
        self.steps = self.following = 0
        self.door: list[tuple[Worker, int, int]] = []
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._order = count()
        self._open()
        self._publish_window()

    def run(self, seconds: float) -> float:
        """Let time pass; return the environment steps a second that were accepted in it."""
        end, before = self.now + seconds, self.accepted
        self._at(0.0, self._tick)
        while self._events and self._events[0][0] < end:
            self.now, _, event = heapq.heappop(self._events)
            event()
        return (self.accepted - before) / seconds

    def _at(self, delay: float, event: Callable[[], None]) -> None:
        heapq.heappush(self._events, (self.now + delay, next(self._order), event))

    def _fly(self, worker: Worker) -> None:
        window, asked = worker.window, worker.asked
        if self.published_at > worker.answered:
            _, window, asked = self.published
        waits = window <= worker.under_way or worker.version < worker.required or worker.unanswered == 2
        if worker.flying or waits or (worker.name == str(self.gone) and worker.answered >= 0.0):
            return
        worker.flying, version, steps = True, worker.version, min(self.chunk, asked)
        worker.under_way += steps
        self._at(self.flight * steps / self.chunk, lambda: self._land(worker, version, steps))

    def _land(self, worker: Worker, version: int, steps: int) -> None:
        worker.flying = False
        worker.unanswered += 1
        self.door.append((worker, version, steps))
        self._receive()
        self._fly(worker)

    def _receive(self) -> None:
        while self.door and (self.room.steps or 0) > 0:
            worker, version, steps = self.door.pop(0)
            with self.gate:
                late = self.room.refusal(version)
                if not late:
                    self.room.take(steps)
            self.refused += steps if late else 0
            self.accepted += 0 if late else steps
            if not late and self.updating:
                self.following += steps
            elif not late:
                self.steps += steps
            self.room.answer(worker.name, lambda terms, w=worker, s=steps: self._answered(w, s, terms))
            self._learn()

    def _answered(self, worker: Worker, steps: int, terms: Terms) -> None:
        worker.required, worker.window, worker.asked = terms
        worker.answered = self.now
        worker.unanswered -= 1
        worker.under_way -= steps
        self._at(0.0, lambda: self._fly(worker))

    def _learn(self) -> None:
        if not self.updating and self.steps >= self.size:
            self.updating = True
            self._open()
            self._at(self.update, self._updated)

    def _updated(self) -> None:
        self.number, self.version, self.updating = self.number + 1, self.version + 1, False
        self.steps, self.following = self.following, 0
        self.room.set_version(self.version, updating=self.steps >= self.size)
        for worker in self.workers:
            worker.version = self.version
        self._learn()
        self._open()
        self._tick_once()

    def _open(self) -> None:
        if self.updating:
            self.room.open(self.number + 1, self.size - self.following, updating=True)
        else:
            self.room.open(self.number, self.size - self.steps, updating=False)

    def _publish_window(self) -> None:
        self.published, self.published_at = self.room.terms, self.now
        for worker in self.workers:
            self._at(0.0, lambda worker=worker: self._fly(worker))

    def _tick_once(self) -> None:
        self._open()
        self._receive()
        if self.room.terms.window > self.published.window or self.now - self.published_at >= PROGRESS:
            self._publish_window()

    def _tick(self) -> None:
        self._tick_once()
        self._at(TICK, self._tick)
