"""How many steps workers may fly for the iterations that still learn from them (on policy).

A chunk is refused when its policy is more than L = `max_lag_versions` versions old. So what workers fly beyond the
steps that their policy still serves is flown for nothing. The newest policy serves the open iteration and, before that
iteration's updates begin, L more:

    budget = steps + S (L - ahead)        steps: what the open iteration still takes in; S: steps of an iteration;
                                          ahead: 1 while updates are due, else 0

Every worker that has its answer flies one chunk of c steps. While budget >= 2 c workers, all of them may fly on
without waiting for answers. Below that, a worker flies its next chunk when its answer has come, and answers are held
back, first come first served, while the chunks that are being flown fill the budget.

Several workers share an iteration: they are asked for chunks of

    c = S / workers        at most a whole chunk, and at least `least_steps`

Shorter chunks teach worse where rewards come late, so they are no shorter than a few horizons of the advantages. They
stay whole with memory, and where hindsight pays visits by later ones.
"""

import statistics
import threading
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Final, NamedTuple

from eia_sec.common.clock import monotonic
from eia_sec.common.protocol.codec import NO_LIMIT
from eia_sec.learner.intake.limits import IntakeLimits

REMEMBERED: Final = 2
"""Versions beyond L after which a worker that has delivered nothing is no longer counted."""
STALL_SECONDS: Final = 2.0
STALL_FLIGHTS: Final = 3.0
"""Time with room in which nobody delivered, s, or as a multiple of the longest recent flight, whichever is longer.
Those who were to fly have then probably left, and others fly instead."""
STALL_TYPICAL: Final = 2.0
STALL_MOST: Final = 30.0
"""Nobody waits longer than so many typical (median) flights and so many seconds, however slow one worker is."""
RECENT: Final = 64
"""Flights from which the typical one is found."""


class Terms(NamedTuple):
    """What a worker is asked for; the fields are those of `ChunkAck`."""

    required_version: int = 0
    window: int = NO_LIMIT
    asked_steps: int = NO_LIMIT


Reply = Callable[[Terms], None]
"""Sends an answer."""
Answer = Callable[[], None]


@dataclass(frozen=True)
class _Held:
    worker: str
    reply: Reply


@dataclass(frozen=True)
class _Flight:
    version: int
    began: float
    steps: int


class IterationRoom:
    """The room of the open iteration, who flies for it, and who waits.

    The receiver's thread asks, and the learner's opens iterations. Versions that differ by an imitation alone make no
    chunk older. A restart of the learner forgets which these were, so chunks of before count as older than they are.

    Args:
        limits: S, c and L.
        version: the newest published parameter version.
        gate: the receiver's lock; methods that say so are called with it, all others take it.
        clock: returns monotonic seconds.

    Attributes:
        present: workers that are there, whether they have delivered yet or not; set from outside.
        given_up: chunks that were no longer waited for, because nobody delivered for too long.
    """

    def __init__(
        self, limits: IntakeLimits, version: int, gate: threading.Lock, clock: Callable[[], float] = monotonic
    ) -> None:
        self._limits, self._version, self._gate, self._clock = limits, version, gate, clock
        self._steps: int | None = None
        self._imitations: deque[int] = deque(maxlen=RECENT)
        self._ahead, self._iteration = 0, -1
        self._flying: dict[str, _Flight] = {}
        self._held: list[_Held] = []
        self._seen, self._longest = clock(), 0.0
        self._recent: deque[float] = deque(maxlen=RECENT)
        self.present = self.given_up = 0

    def open(self, iteration: int, steps: int, *, updating: bool) -> None:
        """Let an iteration take in its steps; a repeated call opens nothing again.

        To be called regularly, because it also lets held answers go out.

        Args:
            iteration: its number.
            steps: environment steps that it takes in.
            updating: whether another version is published before the steps are learned from.
        """
        with self._gate:
            self._ahead = int(updating)
            if iteration != self._iteration:
                self._iteration, self._steps, self._seen = iteration, steps, self._clock()
            answers = self._release()
        _send(answers)

    def set_version(self, version: int, *, updating: bool = False, imitated: bool = False) -> None:
        """Set the newest published version, against which the age of chunks is measured.

        Args:
            version: its number.
            updating: see `open`.
            imitated: whether it differs from the one before by an imitation event alone, which makes no chunk older.
        """
        with self._gate:
            if imitated:
                self._imitations.append(version)
            self._version, self._ahead, self._seen = version, int(updating), self._clock()
            kept = (self._limits.most_lag or 0) + REMEMBERED
            self._flying = {name: flight for name, flight in self._flying.items() if self._age(flight.version) <= kept}
            answers = self._release()
        _send(answers)

    def lift(self) -> None:
        """Take in chunks without limit, and answer everybody."""
        with self._gate:
            self._steps = None
            answers = self._release()
        _send(answers)

    def answer(self, worker: str, reply: Reply) -> None:
        """Answer a worker whose chunks are settled, now or when there is room for its next one.

        A worker that asks again while its answer is held back may be ending: it is answered at once, and waits for the
        next published window.
        """
        with self._gate:
            self._land(worker)
            others = [held for held in self._held if held.worker != worker]
            if len(others) < len(self._held):
                self._held, answers = others, [lambda: reply(Terms(window=0))]
            elif not others and (self._steps is None or self._free() > 0):
                answers = [self._grant(worker, reply, self._oldest())]
            else:
                self._held.append(_Held(worker, reply))
                answers = []
            # There may be more room than before, because the worker flies no longer.
            answers += self._release()
        _send(answers)

    def holds(self, worker: str) -> bool:
        """Return whether a worker's answer is held back."""
        with self._gate:
            return any(held.worker == worker for held in self._held)

    @property
    def steps(self) -> int | None:
        """Environment steps that the open iteration still takes in; None where there is no limit."""
        with self._gate:
            return self._steps

    @property
    def terms(self) -> Terms:
        """What a worker is asked for that needs no newer version."""
        with self._gate:
            return self._terms(0)

    def is_open(self) -> bool:
        """Return whether a chunk may be taken in now; with the gate."""
        return self._steps is None or self._steps > 0

    def version_of(self, claimed: int) -> int:
        """Return a chunk's version, at most the newest published one; with the gate."""
        return min(claimed, self._version)

    def refusal(self, version: int) -> str:
        """Return why a chunk of this version is too old, or an empty text; with the gate."""
        age, most = self._age(version), self._limits.most_lag
        return "" if most is None or age <= most else f"its policy is {age} versions old, more than {most}."

    def take(self, steps: int) -> None:
        """Note that so many steps were accepted; with the gate."""
        if self._steps is not None:
            self._steps -= steps

    def _age(self, version: int) -> int:
        """Return the age that a chunk taken in now has when it is learned from, in versions."""
        return self._version + self._ahead - version - sum(event > version for event in self._imitations)

    def _oldest(self) -> int:
        """Return the oldest version whose chunks may still be taken in, at least 0."""
        oldest = max(0, self._version + self._ahead - (self._limits.most_lag or 0))
        while oldest > 0 and self._age(oldest - 1) <= (self._limits.most_lag or 0):
            oldest -= 1
        return oldest

    def _budget(self) -> int:
        """Return the environment steps of the newest policy that are still learned from."""
        more = (self._limits.most_lag or 0) - self._ahead
        return 0 if more < 0 else max(0, self._steps or 0) + more * self._limits.iteration_steps

    def _flyers(self) -> list[_Flight]:
        """Return the chunks that are being flown and not too old by now."""
        return [f for f in self._flying.values() if self._age(f.version) <= (self._limits.most_lag or 0)]

    def _land(self, worker: str) -> None:
        """Note that a worker flies no longer."""
        self._seen = self._clock()
        if (flight := self._flying.pop(worker, None)) is not None:
            self._recent.append(self._seen - flight.began)
            self._longest = max(0.9 * self._longest, self._recent[-1])

    def _free(self) -> int:
        """Return the steps of the budget that nobody flies for."""
        return self._budget() - sum(flight.steps for flight in self._flyers())

    def _chunk(self, workers: int) -> int:
        """Return the environment steps of the next chunk of each of so many workers."""
        limits, workers = self._limits, max(self.present, workers)
        if workers < 2 or limits.least_steps is None:
            return limits.chunk_steps
        return min(limits.chunk_steps, max(limits.least_steps, limits.iteration_steps // workers))

    def _terms(self, required: int) -> Terms:
        if self._steps is None:
            return Terms()
        workers = len(self._flying) + len(self._held)
        budget, chunk = self._budget(), self._chunk(workers)
        roomy = workers > 0 and budget >= 2 * chunk * workers
        return Terms(required, budget // workers - chunk if roomy else min(1, budget), chunk)

    def _release(self) -> list[Answer]:
        """Return the held answers that may go out now."""
        found = []
        if self._held and self._budget() > 0 and self._clock() - self._seen > self._patience():
            self.given_up += len(self._flyers())
            self._flying.clear()
        while self._held and (self._steps is None or self._free() > 0):
            held = self._held.pop(0)
            # The newest parameters may still be on their way, and what is flown with older ones may come too late.
            found.append(self._grant(held.worker, held.reply, self._version))
        return found

    def _patience(self) -> float:
        typical = statistics.median(self._recent) if self._recent else 0.0
        longest = min(STALL_FLIGHTS * self._longest, STALL_TYPICAL * typical + STALL_MOST)
        return max(STALL_SECONDS, longest)

    def _grant(self, worker: str, reply: Reply, required: int) -> Answer:
        if self._steps is None:
            return lambda: reply(Terms())
        self._seen = self._clock()
        workers = len(self._flying) + len(self._held) + 1  # it is in neither: it has landed, and is held no longer
        self._flying[worker] = _Flight(self._version, self._seen, self._chunk(workers))
        terms = self._terms(max(0, required))
        return lambda: reply(terms)


def _send(answers: Iterable[Answer]) -> None:
    """Send answers, without the gate."""
    for answer in answers:
        answer()
