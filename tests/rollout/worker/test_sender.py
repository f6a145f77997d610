"""The sender packs what waits into one request, and drops exactly what the answer settles."""

import queue
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import replace
from itertools import count

import pytest

from eia_sec.common.errors import BusError
from eia_sec.common.loops import Loop, in_thread, run
from eia_sec.common.protocol.chunk_messages import MOST_BYTES, MOST_CHUNKS, from_message, from_request
from eia_sec.common.protocol.messages import ChunkAck, ChunkMessage, DeliveryMessage, Envelope
from eia_sec.rollout.worker import sender as module
from eia_sec.rollout.worker.sender import Sender
from tests.faults.tools.channel import RULES, RUN, TEAM, a_chunk
from tests.system.fleet import until


class Wire:
    """Stands in for the bus: each request waits until the test answers it."""

    def __init__(self) -> None:
        self._asked: queue.Queue[tuple[bytes, bytes]] = queue.Queue()
        self._answers: queue.Queue[bytes | None] = queue.Queue()
        self.refusals = 0

    def asking(
        self, key: str, payload: bytes, timeout: float, attachment: bytes, again: Callable[[float], bool]
    ) -> Loop[bytes | None]:
        self._asked.put((payload, attachment))
        if self.refusals:
            self.refusals -= 1
            raise BusError("refused: replaced.")
        asked = time.monotonic()
        while True:
            with suppress(queue.Empty):
                return self._answers.get_nowait()
            yield 0.002
            if again(time.monotonic() - asked):
                self._asked.put((payload, attachment))
                asked = time.monotonic()

    def close(self) -> None:
        self._answers.put(None)

    def request(self) -> tuple[int, DeliveryMessage, list[ChunkMessage]]:
        """Return the next request: the number of its first chunk, and what is in it."""
        payload, attachment = self._asked.get(timeout=10.0)
        delivery, parts = from_request(payload)
        return Envelope.decode(attachment).sequence, delivery, [ChunkMessage.decode(part) for part in parts]

    def answer(self, *verdicts: str) -> None:
        """Answer it with verdicts, or not at all."""
        reasons = tuple("why" if verdict == "refused" else "" for verdict in verdicts)
        self._answers.put(ChunkAck(verdicts, reasons, 1, 0).encode() if verdicts else None)

    @property
    def silent(self) -> bool:
        """Whether nothing more was asked."""
        return self._asked.empty()


@contextmanager
def sending(monkeypatch: pytest.MonkeyPatch, capacity: int = 100) -> Iterator[tuple[Sender, Wire, Callable[..., None]]]:
    """Give a sender, the wire behind it, and a way to offer chunks by their numbers."""
    monkeypatch.setattr(module, "RETRY_SECONDS", 0.0)
    wire = Wire()
    sender = Sender(wire, RUN, "w", 1, TEAM, replace(RULES, spool_chunks=capacity), 1.0)  # type: ignore[arg-type]  # a wire is all of a bus that it uses

    def offer(*numbers: int) -> None:
        for number in numbers:
            sender.offer(a_chunk(number), version=10 + number)

    thread = in_thread("sender", sender.deliver(), sender.offered)
    try:
        yield sender, wire, offer
    finally:
        sender.close()
        thread.join()


def test_one_chunk_goes_at_once_and_what_waits_meanwhile_goes_together(monkeypatch):
    """The first goes alone; those that come before its answer share the next request, in order, each with its own."""
    with sending(monkeypatch) as (sender, wire, offer):
        offer(1)
        first, delivery, chunks = wire.request()
        assert (first, delivery.oldest, len(chunks)) == (1, 1, 1)
        offer(2, 3, 4)
        sender.flown = 9
        assert wire.silent
        wire.answer("accepted")
        first, delivery, chunks = wire.request()
        assert (first, delivery.oldest, delivery.flown) == (2, 2, 9)
        assert [(chunk.version, chunk.produced) for chunk in chunks] == [(12, 2), (13, 3), (14, 4)]
        assert [from_message(chunk, TEAM, ()).rows.observation[0, 0] for chunk in chunks] == [2, 3, 4]
        wire.answer("accepted", "duplicate", "accepted")
        until(lambda: sender.spooled == 0, "all settled")
        assert (sender.accepted, sender.retries) == (4, 0)


@pytest.mark.parametrize("verdict", ["gap", "damaged", "closed"])
def test_what_is_not_settled_comes_again_with_all_behind_it(monkeypatch, verdict):
    """An answer settles the chunks before the one that has to come again; the next request begins with that one."""
    with sending(monkeypatch) as (sender, wire, offer):
        offer(1)
        wire.request()
        offer(2, 3, 4)
        wire.answer()
        assert [chunk.produced for chunk in wire.request()[2]] == [1, 2, 3, 4]
        wire.answer("accepted", "refused", verdict)
        first, delivery, chunks = wire.request()
        assert (first, delivery.oldest, [chunk.produced for chunk in chunks]) == (3, 3, [3, 4])
        assert (sender.accepted, sender.rejected, sender.in_flight, sender.retries) == (1, 1, 2, 2)
        assert sender.learner_closed == (verdict == "closed")
        wire.answer("accepted", "accepted")
        until(lambda: sender.spooled == 0, "all settled")


def test_a_request_holds_no_more_than_its_limits(monkeypatch):
    """Beyond MOST_CHUNKS chunks, and beyond MOST_BYTES of several, what is left waits for the next request."""
    with sending(monkeypatch) as (_, wire, offer):
        offer(1)
        wire.request()
        offer(*range(2, MOST_CHUNKS + 5))
        wire.answer("accepted")
        assert len(wire.request()[2]) == MOST_CHUNKS
        wire.answer(*["accepted"] * MOST_CHUNKS)
        assert len(wire.request()[2]) == 3
        size = MOST_BYTES // 2
        assert module.fitting([size, size, 1]) == 2
        assert module.fitting([3 * size, 1]) == 1
        wire.answer("accepted", "accepted", "accepted")


def test_a_full_spool_says_so(monkeypatch):
    """Chunks under way count, so the worker makes none for which the spool has no room."""
    with sending(monkeypatch, capacity=2) as (sender, wire, offer):
        offer(1, 2)
        assert sender.full
        assert sender.produced == 2
        wire.request()
        wire.answer("accepted")
        until(lambda: not sender.full, "room")


def test_who_ends_does_not_wait_for_a_learner_that_is_not_there(monkeypatch):
    """The wait ends after MOST_UNTAKEN requests that nobody took; otherwise it would last an hour."""
    with sending(monkeypatch) as (sender, wire, offer):
        offer(1)
        for _ in range(module.MOST_UNTAKEN + 1):
            wire.answer()
        assert not run(sender.wait_empty(3600.0))
        assert sender.spooled == 1


def test_who_ends_waits_for_a_learner_that_comes_back(monkeypatch):
    """One request that somebody takes after some that nobody took empties the spool."""
    with sending(monkeypatch) as (sender, wire, offer):
        offer(1)
        for _ in range(module.MOST_UNTAKEN - 1):
            wire.answer()
        wire.answer("accepted")
        assert run(sender.wait_empty(3600.0))


def test_who_waits_goes_on_with_its_other_work(monkeypatch):
    """What makes the learner take the chunk is done while the sender waits for that."""
    with sending(monkeypatch) as (sender, wire, offer):
        offer(1)
        turns = count()
        assert run(sender.wait_empty(3600.0, lambda: wire.answer("accepted") if next(turns) == 3 else None))


@pytest.mark.parametrize("ending", [True, False])
def test_who_hurries_asks_again_when_an_answer_was_lost(monkeypatch, ending):
    """A request whose answer was lost waits while the worker collects, and is resent fast when run or worker end.

    The same request goes again and again, at longer and longer intervals, and an answer to any of them settles it.
    """
    with sending(monkeypatch) as (sender, wire, offer), ThreadPoolExecutor(1) as pool:
        monkeypatch.setattr(module, "FAST_RESEND_SECONDS", 0.02)
        offer(1)
        assert wire.request()[0] == 1
        offer(2)
        time.sleep(0.2)
        assert wire.silent
        emptied = pool.submit(run, sender.wait_empty(3600.0)) if ending else None
        sender.resend_fast()
        for _ in range(3):
            first, _, chunks = wire.request()
            assert (first, len(chunks)) == (1, 1)
        sender.resend_fast(ending)
        wire.answer("duplicate")
        until(lambda: sender.spooled == 1, "the first settled")
        assert sender.retries >= 3
        while (request := wire.request())[0] == 1:
            pass
        assert (request[0], len(request[2])) == (2, 1)
        wire.answer("accepted")
        until(lambda: sender.spooled == 0, "all settled")
        assert emptied is None or emptied.result(60.0)
        assert (sender.produced, sender.accepted, sender.in_flight) == (2, 2, 0)


def test_a_refusal_is_not_silence(monkeypatch):
    """A learner that refuses every request at once is not mistaken for one that cannot be reached."""
    with sending(monkeypatch) as (sender, wire, offer):
        wire.refusals = module.MOST_UNTAKEN + 1
        offer(1)
        until(lambda: sender.retries > module.MOST_UNTAKEN, "refusals")
        assert sender.untaken == 0
        wire.answer("accepted")
        until(lambda: sender.spooled == 0, "all settled")


def test_a_replaced_start_sends_nothing_more(monkeypatch):
    """The learner says that a newer start delivers: the spool stays as it is, and whoever ends does not wait for it."""
    with sending(monkeypatch) as (sender, wire, offer):
        offer(1)
        wire.request()
        offer(2)
        wire.answer("replaced")
        until(lambda: sender.replaced, "the verdict")
        assert not run(sender.wait_empty(3600.0))
        assert wire.silent
        assert (sender.spooled, sender.accepted, sender.in_flight) == (2, 0, 2)


def test_a_lost_answer_is_asked_for_again_in_lockstep(monkeypatch):
    """Where an answer may take an hour, the request is resent all the same; the first answer to any copy counts."""
    monkeypatch.setattr(module, "ANSWER_SECONDS", 0.05)
    with sending(monkeypatch) as (sender, wire, offer):
        offer(1)
        assert [wire.request()[0] for _ in range(3)] == [1, 1, 1]
        wire.answer("duplicate")
        until(lambda: sender.spooled == 0, "the chunk settled")
        assert sender.accepted == 1
