"""A worker's lease and the environment's desk over a network that loses, repeats and reorders what it carries."""

import random
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from eia_sec.common.errors import EnvironmentOutageError, SchemaError
from eia_sec.common.protocol.environment_messages import (
    DONE,
    GAP,
    LATE,
    LOST,
    MALFORMED,
    TAKEN,
    ClaimAnswer,
    ClaimRequest,
    LeaseAnswer,
    LeaseRequest,
    StepAnswer,
    StepRequest,
)
from eia_sec.common.protocol.environment_values import form_of
from eia_sec.rollout.remote import lease as lease_module
from eia_sec.rollout.remote.copies import Copies
from eia_sec.rollout.remote.desk import LEASE_SECONDS, REPEATED, Desk
from eia_sec.rollout.remote.lease import COUNTS, SILENT_SECONDS, Lease
from eia_sec.rollout.remote.served import agents_of
from tests.rollout.remote import second_environment
from tests.rollout.remote.toy_served import Line

HUGE = {"type": "box", "dtype": "<f8", "shape": [2**24], "low": 0.0, "high": 1.0}
"""A space whose values take 128 MiB each."""


class Network:
    """A link to one desk, with a clock of its own.

    Attributes:
        desk: who answers; None while the environment is away.
        lost, repeated: probabilities that a message is lost, and that an old request arrives again.
    """

    def __init__(self, desk: Desk | None, seed: int = 0, lost: float = 0.0, repeated: float = 0.0) -> None:
        self.desk, self.lost, self.repeated = desk, lost, repeated
        self.now = 0.0
        self._random = random.Random(seed)
        self._old: list[tuple[str, bytes]] = []

    def request(self, key: str, payload: bytes, timeout: float) -> "Sent":
        """Carry a request, or lose it or its answer; now and then carry an old one again, too."""
        verb = key.rpartition("/")[2]
        while self._old and self._random.random() < self.repeated:
            self._deliver(*self._random.choice(self._old))
        self._old.append((verb, payload))
        answer = None if self._random.random() < self.lost else self._deliver(verb, payload)
        return Sent(self, timeout, None if self._random.random() < self.lost else answer)

    def living(self, key: str) -> list[str]:
        """Return the token's key while somebody is there."""
        return [key] if self.desk is not None else []

    def _deliver(self, verb: str, payload: bytes) -> bytes | None:
        return None if self.desk is None else self.desk.answer(verb, payload)


class Sent:
    """A request under way."""

    def __init__(self, network: Network, timeout: float, answer: bytes | None) -> None:
        self._network, self._timeout, self._answer = network, timeout, answer

    def answer(self) -> bytes | None:
        """Return the answer; time passes until it is clear that there is none."""
        self._network.now += 0.001 if self._answer is not None else self._timeout
        return self._answer


@pytest.fixture(autouse=True)
def _hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lease_module, "AGAIN_SECONDS", 0.0)
    COUNTS.resent = COUNTS.refused = 0


def claimed(network: Network, worker: str = "run/0") -> Lease:
    """Return a lease of the desk behind a network."""
    assert network.desk is not None
    granted = ClaimAnswer.decode(network.desk.answer("claim", ClaimRequest(worker, random.getrandbits(60)).encode()))
    assert granted.status == DONE, granted.reason
    return Lease(network, "site-a", granted, agents_of(granted), lambda: network.now)


def desk_of(*environments: Any, incarnation: int = 7) -> Desk:
    return Desk(Copies(environments or [Line()]), incarnation, lambda: 0.0)


def moved(lease: Lease, order: Any) -> dict[str, Any]:
    lease.order(0, order)
    lease.send()
    return lease.take(0)


@pytest.mark.parametrize("seed", range(20))
def test_each_step_is_made_once_whatever_the_network_does(seed: int) -> None:
    """With every third message lost and old ones repeated, the environment gets each action once, and in order."""
    line, wanted = Line(200), random.Random(seed)
    network = Network(desk_of(line), seed, lost=0.3, repeated=0.3)
    lease = claimed(network)
    moved(lease, 5)
    actions = [{"left": wanted.randrange(3), "right": wanted.randrange(3)} for _ in range(60)]
    alone = Line(200)
    alone.reset(seed=5)
    for action in actions:
        found, expected = moved(lease, action), alone.step(action)
        assert {name: seen.tolist() for name, seen in found["observations"].items()} == {
            name: seen.tolist() for name, seen in expected[0].items()
        }
        assert (found["rewards"], found["infos"]) == (expected[1], expected[4])
    assert line.taken == actions
    assert COUNTS.resent > 0
    assert network.desk is not None
    assert network.desk.counts[REPEATED] > 0
    lease.release()


def test_an_outage_is_declared_after_the_silence_and_not_before() -> None:
    """An environment that is back in time goes on with its episode; one that is not costs it."""
    desk = desk_of(Line())
    network = Network(desk)
    lease = claimed(network)
    moved(lease, 1)
    lease.order(0, {"left": 0, "right": 0})
    network.desk = None
    lease.send()
    began = network.now
    with pytest.raises(EnvironmentOutageError, match="site-a has not been seen for 10 s"):
        lease.take(0)
    assert SILENT_SECONDS <= network.now - began < 2.5 * SILENT_SECONDS
    assert lease.lost

    network = Network(desk_of(Line()))
    network.desk, there = None, network.desk
    lease = Lease(network, "site-a", *_granted(there), lambda: network.now)
    lease.order(0, 1)
    lease.send()
    network.desk = there
    assert lease.take(0)["agents"] == ["left", "right"]
    assert not lease.lost
    lease.release()


def _granted(desk: Desk | None) -> tuple[ClaimAnswer, Any]:
    assert desk is not None
    granted = ClaimAnswer.decode(desk.answer("claim", ClaimRequest("run/0", 1).encode()))
    return granted, agents_of(granted)


def test_an_environment_that_was_started_anew_ends_the_episode_at_once() -> None:
    """The new incarnation refuses the old lease, and says so."""
    network = Network(desk_of(Line()))
    lease = claimed(network)
    moved(lease, 1)
    network.desk = desk_of(Line(), incarnation=8)
    with pytest.raises(EnvironmentOutageError, match="lost: the environment has been started anew"):
        moved(lease, {"left": 0, "right": 0})
    assert lease.lost
    assert network.desk.counts == {LOST: 1}
    assert network.now < 1.0


def test_a_late_worker_moves_nothing() -> None:
    """When another worker holds the environment, the first one's step is refused and not made."""
    line, now = Line(), [0.0]
    desk = Desk(Copies([line]), 7, lambda: now[0])
    first = claimed(Network(desk))
    moved(first, 1)
    refused = ClaimAnswer.decode(desk.answer("claim", ClaimRequest("run/1", 2).encode()))
    assert (refused.status, refused.reason) == (TAKEN, "it is taken by run/0.")
    now[0] = LEASE_SECONDS + 0.1
    second = claimed(Network(desk), "run/1")
    moved(second, 2)
    with pytest.raises(EnvironmentOutageError, match=r"lost: the lease went to run/1\."):
        moved(first, {"left": 0, "right": 0})
    assert line.taken == []
    moved(second, {"left": 2, "right": 2})
    assert line.taken == [{"left": 2, "right": 2}]
    second.release()
    assert desk.holder == ""


def test_an_expired_lease_that_nobody_claimed_goes_on() -> None:
    """A pause of its worker costs nothing as long as nobody else comes."""
    now = [0.0]
    desk = Desk(Copies([Line()]), 7, lambda: now[0])
    lease = claimed(Network(desk))
    moved(lease, 1)
    now[0] = 600.0
    assert moved(lease, {"left": 0, "right": 0})["rewards"]
    lease.release()


@pytest.mark.parametrize(
    "answered", [desk_of(Line()).answer, second_environment.Environment().handle], ids=["desk", "second"]
)
def test_what_is_answered_to_repeats_and_to_strangers(answered: Callable[[str, bytes], bytes]) -> None:
    """Repeated claims and steps get the first answer again; late, early, strange and unreadable ones are refused."""
    claim = ClaimRequest("run/0", 5).encode()
    granted = ClaimAnswer.decode(answered("claim", claim))
    left, right = granted.agents

    def step(sequence: int, copies: Any, lease: int = granted.lease, before: int = 0) -> StepAnswer:
        request = StepRequest(granted.incarnation - before, lease, sequence, copies)
        return StepAnswer.decode(answered("step", request.encode()))

    def keep(verb: str, lease: int = granted.lease) -> str:
        return LeaseAnswer.decode(answered(verb, LeaseRequest(granted.incarnation, lease).encode())).status

    assert ClaimAnswer.decode(answered("claim", claim)) == granted
    first = step(1, [3])
    assert first.status == DONE
    assert step(1, [3]) == first
    assert step(2, [{left: 0, right: 0}]).status == DONE
    assert step(1, [3]).status == LATE
    assert step(4, [3]).status == GAP
    for strange in ([], [3, 3], [-1], ["x"], [{left: 0}], [{left: 0, "other": 0}], [{left: 0, right: "x"}]):
        assert step(3, strange).status == MALFORMED
    for action in (-1, 3, 10**9, True):
        assert step(3, [{left: 0, right: action}]).status == MALFORMED
    assert step(3, [3], lease=granted.lease + 1).status == LOST
    assert step(3, [3], before=1).status == LOST
    assert ClaimAnswer.decode(answered("claim", claim)).status == TAKEN
    assert StepAnswer.decode(answered("step", b"\xc1")).status == MALFORMED
    assert [keep("renew"), keep("renew", granted.lease + 1)] == [DONE, LOST]
    assert keep("extend") == MALFORMED
    assert step(3, [{left: 1, right: 0}]).status == DONE
    assert [keep("release"), keep("release")] == [DONE, LOST]
    assert step(4, [3]).status == LOST
    assert ClaimAnswer.decode(answered("claim", claim)).status == LOST
    assert ClaimAnswer.decode(answered("claim", ClaimRequest("run/1", 6).encode())).lease == granted.lease + 1
    assert step(1, [3]).status == LOST


def test_an_unknown_request_renews_nothing() -> None:
    """Only the requests that the page names keep a lease."""
    now = [0.0]
    desk = Desk(Copies([Line()]), 7, lambda: now[0])
    claim = ClaimAnswer.decode(desk.answer("claim", ClaimRequest("run/0", 1).encode()))
    now[0] = LEASE_SECONDS - 0.1
    strange = LeaseAnswer.decode(desk.answer("extend", LeaseRequest(7, claim.lease).encode()))
    assert (strange.status, desk.counts) == (MALFORMED, {MALFORMED: 1})
    now[0] = LEASE_SECONDS
    assert ClaimAnswer.decode(desk.answer("claim", ClaimRequest("run/1", 2).encode())).status == DONE


def test_every_refusal_is_counted() -> None:
    """The desk counts what it did not carry out, by what it answered, and what it answered again."""
    desk = desk_of(Line())
    for _ in range(2):
        desk.answer("claim", ClaimRequest("run/0", 5).encode())
    for sequence, copies in ((1, [3]), (1, [3]), (0, [3]), (9, [3]), (2, ["x"])):
        desk.answer("step", StepRequest(7, 1, sequence, copies).encode())
    for message in (ClaimRequest("run/1", 6), ClaimRequest("run/2", 7)):
        desk.answer("claim", message.encode())
    desk.answer("renew", LeaseRequest(7, 3).encode())
    assert desk.counts == {REPEATED: 2, LATE: 1, GAP: 1, MALFORMED: 1, TAKEN: 2, LOST: 1}


def test_an_outage_that_the_environment_declares_keeps_the_lease() -> None:
    """The robot is in emergency stop: its episode ends, and its worker tries to begin another one."""
    line = Line(away=0.05)
    desk = desk_of(line)
    lease = claimed(Network(desk))
    moved(lease, 1)
    for _ in range(9):
        moved(lease, {"left": 0, "right": 0})
    with pytest.raises(EnvironmentOutageError, match="site-a: the arm is in emergency stop"):
        moved(lease, {"left": 0, "right": 0})
    assert not lease.lost
    line._until = 0.0
    assert moved(lease, 2)["agents"] == ["left", "right"]
    lease.release()


def test_an_error_in_the_environments_code_is_told_and_kept() -> None:
    """The worker's episode ends with the error's words; the environment's process gets the exception."""
    desk = desk_of(Line(fail=1))
    lease = claimed(Network(desk))
    moved(lease, 1)
    with pytest.raises(EnvironmentOutageError, match="fault: RuntimeError: the wheel has come off"):
        moved(lease, {"left": 0, "right": 0})
    assert isinstance(desk.failure, RuntimeError)


def test_copies_move_together() -> None:
    """One message moves the copies that have an order, and leaves the others alone."""
    lines = [Line(), Line(), Line()]
    network = Network(desk_of(*lines))
    lease = claimed(network)
    for copy in (0, 2):
        lease.order(copy, copy)
    lease.send()
    assert [lease.take(copy)["agents"] for copy in (0, 2)] == [["left", "right"]] * 2
    for copy in (0, 2):
        lease.order(copy, {"left": copy, "right": 1})
    lease.send()
    assert all(lease.take(copy)["rewards"] for copy in (2, 0))
    assert [line.taken for line in lines] == [[{"left": 0, "right": 1}], [], [{"left": 2, "right": 1}]]
    lease.release()


@pytest.mark.parametrize(
    "answer",
    [
        b"\xc1",
        StepAnswer(DONE, "", 1, []).encode(),
        StepAnswer(DONE, "", 1, [None]).encode(),
        StepAnswer(DONE, "", 1, [{"agents": ["other"]}]).encode(),
        StepAnswer(DONE, "", 1, [{"agents": [], "observations": {"left": b"short"}}]).encode(),
        StepAnswer(DONE, "", 1, [{"agents": [], "rewards": {"left": "much"}}]).encode(),
        StepAnswer(DONE, "", 1, [{"agents": [], "infos": {"left": 3}}]).encode(),
        StepAnswer(DONE, "", 2, [{"agents": []}]).encode(),
        b"\xdd\xff\xff\xff\xff",
    ],
)
def test_an_answer_that_cannot_be_used_is_an_outage(answer: bytes) -> None:
    """A worker does not trust what an environment sends: the episode ends, and the answer is counted."""
    desk = desk_of(Line())
    network = Network(desk)
    lease = claimed(network)
    network.request = lambda key, payload, timeout: Sent(network, timeout, answer)  # type: ignore[method-assign]  # it lies to one lease
    with pytest.raises(EnvironmentOutageError, match="site-a answers what cannot be used"):
        moved(lease, 1)
    assert COUNTS.refused == 1


@pytest.mark.parametrize("left_out", ["rewards", "terminations", "truncations"])
def test_an_agent_that_acted_and_lives_needs_reward_termination_and_truncation(left_out: str) -> None:
    """An answer without one of them is an outage; an agent that has left needs none."""
    said: dict[str, Any] = {
        "rewards": {"left": 1.0},
        "terminations": {"left": False},
        "truncations": {"left": False},
        "agents": ["left"],
    }
    desk = desk_of(Line())
    network = Network(desk)
    lease = claimed(network)
    moved(lease, 1)
    honest = StepAnswer(DONE, "", 2, [said]).encode()
    network.request = lambda key, payload, timeout: Sent(network, timeout, honest)  # type: ignore[method-assign]  # it answers once
    assert moved(lease, {"left": 0, "right": 0})["rewards"] == {"left": 1.0}
    lying = StepAnswer(DONE, "", 3, [{**said, left_out: {}}]).encode()
    network.request = lambda key, payload, timeout: Sent(network, timeout, lying)  # type: ignore[method-assign]  # and lies then
    with pytest.raises(EnvironmentOutageError, match="acted and still lives has no reward, termination or truncation"):
        moved(lease, {"left": 0})


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ({"lease_seconds": 3601.0}, "no lease of at most 3600 s"),
        ({"lease_seconds": float("inf")}, "no lease of at most 3600 s"),
        ({"lease_seconds": float("nan")}, "no lease of at most 3600 s"),
        ({"action_spaces": [HUGE] * 2}, "take or bring more than 256 MiB"),
        ({"observation_spaces": [HUGE] * 2}, "take or bring more than 256 MiB"),
    ],
)
def test_a_claims_answer_that_asks_too_much_is_refused(other: dict[str, Any], said: str) -> None:
    """Neither memory is taken nor a thread started for it."""
    granted, _ = _granted(desk_of(Line()))
    with pytest.raises(SchemaError, match=said):
        agents_of(replace(granted, **other))


@pytest.mark.parametrize(
    ("space", "fits", "strange"),
    [
        ({"type": "discrete", "n": 3, "start": 5}, [5, 7], [4, 8, 10**9, True, "5"]),
        (
            {"type": "multi_discrete", "nvec": [2, 3], "start": [0, -1]},
            [[0, -1], [1, 1]],
            [[2, 0], [0, 2], [0, -2], [10**9, 0], [0], 0],
        ),
        ({"type": "multi_binary", "shape": [2]}, [b"\0\1"], [b"\0\2", b"\xff\0", b"\0"]),
    ],
)
def test_only_options_of_a_space_are_read_and_sent(space: dict[str, Any], fits: list[Any], strange: list[Any]) -> None:
    """A robot gets no choice that its space does not have."""
    form = form_of(space)
    for raw in fits:
        assert form.pack(form.unpack(raw)) == raw
    for raw in strange:
        with pytest.raises(SchemaError):
            form.unpack(raw)
    outside = [2, 2] if space["type"] != "discrete" else 2
    with pytest.raises(ValueError, match=r"none of|0 or 1"):
        form.pack(outside)
