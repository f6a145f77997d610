"""A bad road for messages, without a network: frames between many workers and the learner's front door.

The road duplicates, reorders, cuts and flips; it knows exactly what it did, so the receiver's counters can be held
against it.
"""

import queue
import random
import threading
from collections import Counter, deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from eia_sec.common.farm import METRIC_NAMES
from eia_sec.common.history.history import History
from eia_sec.common.loops import in_thread
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.chunk_messages import from_request, to_message, to_request
from eia_sec.common.protocol.chunk_rules import ChunkRules
from eia_sec.common.protocol.messages import ChunkAck, Envelope
from eia_sec.common.team import GroupSpec, TeamSpec
from eia_sec.common.transitions import TRANSITION, Chunk, Rows
from eia_sec.learner.intake.arrival import Arrival
from eia_sec.learner.intake.ledger import Ledger
from eia_sec.learner.intake.limits import IntakeLimits
from eia_sec.learner.intake.receiver import Receiver
from tests.system.fleet import until

TEAM = TeamSpec((GroupSpec("one", 2, 3, 2),))
RUN = "road"
RULES = ChunkRules(
    environments=1, chunk_steps=1, spool_chunks=64, shortest=1, longest=100, episode_metrics=METRIC_NAMES
)


class Parcel:
    """One request as the receiver sees it; the answer is kept."""

    def __init__(self, key: str, payload: bytes, attachment: bytes) -> None:
        self.key, self.payload, self.attachment = key, payload, attachment
        self.answer: ChunkAck | None = None
        self.refused = ""
        self.answered = threading.Event()

    @property
    def verdict(self) -> str:
        """The verdict on the only chunk."""
        assert self.answer is not None, self.refused
        (verdict,) = self.answer.verdicts
        return verdict

    def reply(self, payload: bytes) -> None:
        self.answer = ChunkAck.decode(payload)
        self.answered.set()

    def refuse(self, reason: str) -> None:
        self.refused = reason
        self.answered.set()


class Door:
    """Stands in for the server: hands parcels to the receiver's thread, one after the other."""

    def __init__(self) -> None:
        self._waiting: queue.Queue[Parcel | None] = queue.Queue(64)
        self.thread: threading.Thread

    def __iter__(self) -> Iterator[Parcel]:
        while (parcel := self._waiting.get()) is not None:
            yield parcel

    def push(self, parcel: Parcel) -> None:
        """Deliver a parcel; return when the receiver has taken it in hand."""
        self._waiting.put(parcel)
        until(self._waiting.empty, "a parcel's way")

    def pass_on(self, parcel: Parcel) -> Parcel:
        """Deliver a parcel and wait until it is answered."""
        self._waiting.put(parcel)
        if not parcel.answered.wait(60.0):
            raise AssertionError("a request was never answered")
        return parcel

    def close(self) -> None:
        self._waiting.put(None)


def a_chunk(number: int) -> Chunk:
    """Return a chunk of two rows that bears its number."""
    flag = np.array([TRANSITION, 0], np.uint8)
    shape = lambda size: np.full((2, size), 0.5, np.float32)  # noqa: E731  # three arrays of one kind, one line each
    observation = shape(TEAM.observation_size)
    observation[0, 0] = number
    return Chunk(Rows(observation, shape(TEAM.action_size), shape(TEAM.agents), flag))


def with_log_probabilities(chunk: Chunk) -> Chunk:
    """Return the chunk as a worker of an algorithm that learns on policy sends it."""
    log_probability = np.full_like(chunk.rows.reward, -1.0)
    return replace(chunk, rows=replace(chunk.rows, log_probability=log_probability))


@dataclass
class Road:
    """What the road does, each with its chance, and what it did.

    A request holds one chunk or several, so the chances are somewhat above the shares of chunks that are wanted: a
    tenth doubled, a tenth overtaken, a hundredth cut and a hundredth flipped.

    Attributes:
        duplicated, reordered, cut, flipped: chance of each for one sending.
        done: how often each was done, and how much of it is `unseen`: flips in chunks that nobody looked at, because
            one before them in the same request had to come again.
    """

    duplicated: float = 0.15
    reordered: float = 0.3
    cut: float = 0.014
    flipped: float = 0.014
    done: Counter[str] = field(default_factory=Counter)


class Sending:
    """One worker that keeps several requests on the road at once, so that they can overtake one another."""

    def __init__(self, name: str, chunks: int, window: int = 4) -> None:
        self.name, self.chunks, self.window = name, chunks, window
        self.held: deque[int] = deque()
        self.made = 0

    def parcel(self, numbers: list[int]) -> Parcel:
        sealed = [to_message(a_chunk(number), TEAM, 1, produced=number).encode() for number in numbers]
        payload = to_request(sealed, oldest=min([*self.held, *numbers]), flown=numbers[-1])
        envelope = Envelope("rollout", self.name, 1, numbers[0], 1)
        return Parcel(keys.TRANSITION.key(RUN, worker=self.name), payload, envelope.encode())

    def fill(self) -> None:
        while len(self.held) < self.window and self.made < self.chunks:
            self.made += 1
            self.held.append(self.made)

    def requests(self, draw: random.Random) -> list[list[int]]:
        """Return what is held as consecutive numbers, cut into requests anywhere."""
        cut: list[list[int]] = []
        for number in self.held:
            if cut and cut[-1][-1] == number - 1 and draw.random() < 0.5:
                cut[-1].append(number)
            else:
                cut.append([number])
        return cut


def travel(road: Road, workers: int, chunks: int, receiver: Receiver, door: Door, seed: int = 0) -> dict[str, Any]:
    """Send `chunks` chunks of each worker over the road until all are answered; return what came out.

    Raises:
        AssertionError: when a damaged frame is taken, or an answer is none that a worker could use.
    """
    draw = random.Random(seed)
    sendings = [Sending(str(index), chunks) for index in range(workers)]
    accepted: Counter[tuple[str, int]] = Counter()
    seen: Counter[str] = Counter()
    ended = threading.Event()

    def absorb() -> None:
        while not ended.is_set() or not receiver.arrivals.empty():
            if (arrival := next_arrival(receiver, 0.05)) is None:
                continue
            number = int(arrival.chunk.rows.observation[0, 0])
            assert number == arrival.sender.sequence
            accepted[arrival.sender.name, number] += 1

    absorber = threading.Thread(target=absorb)
    absorber.start()
    try:
        while any(sending.held or sending.made < chunks for sending in sendings):
            for sending in sendings:
                sending.fill()
                _turn(sending, road, door, draw, seen)
    finally:
        ended.set()
        absorber.join()
    return {"accepted": accepted, "answers": seen}


def _turn(sending: Sending, road: Road, door: Door, draw: random.Random, seen: Counter[str]) -> None:
    """Send everything that is held once, in an order that the road chooses, and let go of what was taken."""
    requests = sending.requests(draw)
    for index in range(len(requests) - 1):
        if draw.random() < road.reordered:
            road.done["reordered"] += 1
            requests[index], requests[index + 1] = requests[index + 1], requests[index]
    for numbers in requests:
        again = draw.random() < road.duplicated
        for copy in range(1 + again):
            road.done["duplicated"] += copy
            road.done["several"] += len(numbers) > 1
            parcel = sending.parcel(numbers)
            kind, place = damage(parcel, road, draw)
            answer = door.pass_on(parcel).answer
            assert answer is not None, parcel.refused
            road.done["unseen"] += place >= len(answer.verdicts)
            seen.update(answer.verdicts)
            seen["sendings"] += 1
            assert not (kind and answer.verdicts == ("accepted",) * len(numbers)), f"a {kind} frame was taken"
            for number, verdict in zip(numbers, answer.verdicts, strict=False):
                if verdict in ("accepted", "duplicate") and number in sending.held:
                    sending.held.remove(number)


def damage(parcel: Parcel, road: Road, draw: random.Random) -> tuple[str, int]:
    """Damage a request by chance; return how, and at which of its chunks; 0 too where all of it becomes unreadable."""
    chance = draw.random()
    if chance < road.cut:
        road.done["cut"] += 1
        parcel.payload = parcel.payload[: draw.randrange(len(parcel.payload))]
        return "cut", 0
    if chance < road.cut + road.flipped:
        road.done["flipped"] += 1
        ends = np.cumsum([len(part) for part in from_request(parcel.payload)[1]])
        damaged = bytearray(parcel.payload)
        at = draw.randrange(len(damaged))
        damaged[at] ^= 1 << draw.randrange(8)
        parcel.payload = bytes(damaged)
        return "flipped", int(np.searchsorted(ends, at - (len(damaged) - ends[-1]), side="right"))
    return "", 0


def front_door(ledger: Ledger | None = None, history: History | None = None, **limits: int) -> tuple[Receiver, Door]:
    """Return a receiver and the door before it."""
    door = Door()
    bounds = IntakeLimits(**{"chunks": 64, "most_lag": None, **limits})
    return receiving(door, RULES, bounds, ledger=ledger, history=history), door


def receiving(
    door: Door,
    rules: ChunkRules,
    limits: IntakeLimits,
    *,
    lockstep: bool = False,
    ledger: Ledger | None = None,
    history: History | None = None,
    resumed: bool = False,
) -> Receiver:
    """Return a receiver whose loop runs in a thread, as in a learner."""
    server: Any = door  # all of a server that a receiver uses
    receiver = Receiver(server, TEAM, rules, ledger or Ledger(), limits, lockstep, history, resumed=resumed)
    door.thread = in_thread("receiver", receiver.receive())
    return receiver


def next_arrival(receiver: Receiver, seconds: float) -> Arrival | None:
    """Return the next chunk, or None when nothing wakes the learner in this time."""
    if receiver.arrivals.empty():
        receiver.dealt_with.wait(seconds)
        receiver.dealt_with.clear()
    with suppress(queue.Empty):
        return receiver.arrivals.get_nowait()
    return None


def shut(receiver: Receiver, door: Door) -> None:
    """End the receiver's thread."""
    receiver.close()
    door.close()
    door.thread.join()
