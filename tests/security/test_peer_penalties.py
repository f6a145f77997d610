"""Whoever keeps sending bad input is blocked and named, and comes back with a good one; wildcards are dropped."""

import time

import pytest

from eia_sec.common.config import RunConfig
from eia_sec.common.errors import BusError
from eia_sec.common.loops import in_thread
from eia_sec.common.protocol import keys
from eia_sec.common.protocol.chunk_rules import ChunkRules
from eia_sec.common.protocol.messages import Envelope
from eia_sec.common.transport.bus import Bus, Sample, Server, Subscription
from eia_sec.common.transport.endpoint import free_endpoint
from eia_sec.learner.intake.ledger import Ledger
from eia_sec.learner.intake.limits import IntakeLimits
from eia_sec.learner.intake.peer_penalties import BLOCK_SECONDS, LIMIT, MOST_PEERS, PeerPenalties
from eia_sec.learner.intake.receiver import Receiver
from eia_sec.learner.intake.throttle import HOLD_SECONDS, MOST_BYTES, MOST_HELD, Throttle
from eia_sec.rollout.envs.registry import environment_spec

ENVIRONMENT = environment_spec(RunConfig())

RUN = "run"


class Clock:
    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_a_row_of_bad_requests_blocks_for_a_while():
    """LIMIT in a row block; after the pause one more bad one does; a good one clears."""
    clock = Clock()
    peer_penalties = PeerPenalties(clock)
    assert [peer_penalties.bad("w", "cut") for _ in range(LIMIT)] == [False] * (LIMIT - 1) + [True]
    assert f"after {LIMIT} bad requests in a row; the last: cut" in str(peer_penalties.refusal("w"))
    assert peer_penalties.alarms() == [peer_penalties.refusal("w")]
    assert peer_penalties.refusal("other") is None
    clock.now = BLOCK_SECONDS
    assert (peer_penalties.refusal("w"), peer_penalties.alarms()) == (None, [])
    assert peer_penalties.bad("w", "again")
    assert peer_penalties.refusal("w") is not None
    clock.now = 2 * BLOCK_SECONDS
    peer_penalties.good("w")
    assert not peer_penalties.bad("w", "once")
    assert peer_penalties.counts() == {"w": LIMIT + 2}


def test_the_account_is_bounded_and_loses_no_count():
    """Beyond MOST_PEERS names the oldest goes, and the sum stays."""
    peer_penalties = PeerPenalties()
    for index in range(MOST_PEERS + 50):
        peer_penalties.bad(f"w{index}", "bad")
    assert sum(peer_penalties.counts().values()) == MOST_PEERS + 50
    assert len(peer_penalties.counts()) <= 9


class Request:
    """A request that remembers its refusal."""

    def __init__(self, size: int = 0) -> None:
        self.payload = bytes(size)
        self.refused: str | None = None

    def refuse(self, reason: str) -> None:
        self.refused = reason


def test_refusals_are_held_back_for_a_while():
    """Each is refused HOLD_SECONDS after it came, with its reason, and counted; its payload is not kept."""
    clock, requests = Clock(), [Request(10), Request(10)]
    throttle = Throttle(clock)
    throttle.hold(requests[0], "first")
    clock.now = HOLD_SECONDS / 2
    throttle.hold(requests[1], "second")
    assert [request.refused for request in requests] == [None, None]
    clock.now = HOLD_SECONDS
    throttle.release()
    assert [request.refused for request in requests] == ["first", None]
    clock.now *= 2
    throttle.release()
    assert requests[1].refused == "second"
    assert (throttle.turned_away, requests[0].payload) == (2, b"")


@pytest.mark.parametrize(("size", "most"), [(0, MOST_HELD), (MOST_BYTES // 4, 4), (2 * MOST_BYTES, 0)])
def test_what_is_held_back_is_bounded(size, most):
    """Beyond so many requests, or so much memory, the oldest is refused at once."""
    throttle, requests = Throttle(Clock()), [Request(size) for _ in range(most + 3)]
    for request in requests:
        throttle.hold(request, "no")
    assert [request.refused for request in requests] == ["no"] * 3 + [None] * most


def test_the_receiver_cuts_off_one_worker_and_serves_the_others(monkeypatch):
    """A worker that sends rubbish is refused by name after LIMIT tries; another is still looked at."""
    monkeypatch.setattr("eia_sec.learner.intake.throttle.HOLD_SECONDS", 0.0)
    endpoint = free_endpoint()
    with Bus.listen(endpoint, "bulk") as bus, Bus.connect(endpoint, "bulk", wait=5.0) as worker:
        receiver = Receiver(
            bus.serve(keys.TRANSITION.pattern(RUN), 16),
            ENVIRONMENT.team,
            ChunkRules.of(RunConfig(), ENVIRONMENT),
            Ledger(),
            IntakeLimits(16, None),
            lockstep=False,
        )
        receiving = in_thread("receiver", receiver.receive())
        try:
            time.sleep(0.3)
            answers = [send(worker, "bad", number) for number in range(1, LIMIT + 3)]
            assert "blocked" in answers[-1]
            assert not any("blocked" in text for text in answers[:LIMIT])
            assert "blocked" not in send(worker, "other", 1)
            assert "blocked" in receiver.peer_penalties.alarms()[0]
            assert receiver.peer_penalties.counts() == {"bad": LIMIT, "other": 1}
        finally:
            bus.close()
            receiving.join()


def send(bus: Bus, worker: str, number: int) -> str:
    """Send rubbish in a worker's name; return the refusal."""
    envelope = Envelope("elite", worker, 1, number)
    with pytest.raises(BusError) as refused:
        bus.ask(keys.TRANSITION.key(RUN, worker=worker), b"rubbish", 5.0, envelope.encode())
    return str(refused.value)


def test_samples_and_requests_with_wildcards_are_dropped_and_counted():
    """A put on ** reaches no subscriber, and a request on ** is refused; both are counted."""
    endpoint = free_endpoint()
    with Bus.listen(endpoint, "control") as bus, Bus.connect(endpoint, "control", wait=5.0) as other:
        subscription: Subscription = bus.subscribe("a/x", 8)
        server: Server = bus.serve("a/x", 8)
        session = other._open()
        time.sleep(0.3)
        session.put("a/*", b"wild")
        session.put("a/x", b"tame")
        replies = session.get("a/**", timeout=3.0)
        deadline = time.monotonic() + 5.0
        got: list[Sample] = []
        while (not got or not server.wild) and time.monotonic() < deadline:
            got += subscription.drain()
            assert server.poll() is None
            time.sleep(0.01)
        assert ([sample.payload for sample in got], subscription.wild, server.wild) == ([b"tame"], 1, 1)
        assert [reply.err.payload.to_string() for reply in replies if reply.err] != []
