"""The four deliveries over a real Zenoh session on loopback."""

import re
import resource
import socket
import threading
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import zenoh

from eia_sec.common.errors import BusClosedError, BusError, CancelledError, EndpointError
from eia_sec.common.transport import bus as bus_module
from eia_sec.common.transport.bus import Bus, Incoming, Sample, Server, Subscription
from eia_sec.common.transport.endpoint import Endpoint, free_endpoint
from eia_sec.common.transport.zenoh_config import connecting, document

SECONDS = 10.0


def until(poll: Callable[[], Any]) -> Any:
    """Return the first value that is not None, within SECONDS."""
    deadline = time.monotonic() + SECONDS
    while time.monotonic() < deadline:
        if (found := poll()) is not None:
            return found
        time.sleep(0.005)
    raise AssertionError("nothing came in time")


@pytest.fixture
def endpoint() -> Endpoint:
    return free_endpoint()


@pytest.fixture
def pair(endpoint: Endpoint) -> Iterator[tuple[Bus, Bus]]:
    with Bus.listen(endpoint, "control") as listener, Bus.connect(endpoint, "control", wait=5.0) as client:
        yield listener, client


def echo(bus: Bus, key: str) -> threading.Thread:
    server = bus.serve(key, 8)

    def loop() -> None:
        for incoming in server:
            if incoming.payload == b"no":
                incoming.refuse("not today")
            else:
                incoming.reply(incoming.payload + incoming.attachment)

    thread = threading.Thread(target=loop)
    thread.start()
    return thread


def test_requests_are_answered_refused_or_unserved(pair: tuple[Bus, Bus]) -> None:
    """An answer comes back; a refusal raises with its reason; a key that nobody serves gives None."""
    listener, client = pair
    thread = echo(listener, "a/*")
    assert until(lambda: client.ask("a/x", b"1", 2.0, b"2")) == b"12"
    with pytest.raises(BusError, match="not today"):
        client.ask("a/x", b"no", 2.0)
    assert client.ask("b/x", b"1", 2.0) is None
    listener.close()
    thread.join(SECONDS)
    assert not thread.is_alive()


def test_a_request_is_made_again_and_any_answer_counts(pair: tuple[Bus, Bus]) -> None:
    """An owner that answers the first copy late, or only a later one, is heard either way, long before time is up."""
    owner, other = pair
    server = owner.serve("t/slow", 8)
    for answered in (0, 1, 2):
        copies: list[Incoming] = []

        def again(waited: float, copies: list[Incoming] = copies, answered: int = answered) -> bool:
            before = len(copies)
            copies.extend(server.waiting())
            if len(copies) == 3 > before:
                copies[answered].reply(bytes([answered]))
            return before < len(copies) < 3

        assert other.ask("t/slow", b"x", 3600.0, again=again) == bytes([answered])
        assert [copy.payload for copy in copies] == [b"x"] * 3


def test_who_asks_without_end_does_not_keep_the_server() -> None:
    """Of requests that never end, as many as may wait are given out at a time."""

    class Endless:
        key_expr, payload, attachment = "a/x", None, None

        @property
        def handler(self) -> "Endless":
            return self

        def try_recv(self) -> "Endless":
            return self

    server = Server(Endless(), 3)
    assert [incoming.key for incoming in server.waiting()] == ["a/x"] * 3


def test_a_server_of_the_newest_requests_keeps_its_link_free(pair: tuple[Bus, Bus]) -> None:
    """While nobody takes its requests, the session still gets the answers to its own; the oldest requests end."""
    listener, client = pair
    echo(listener, "a/*")
    server = client.serve("t/busy", 3, newest=True)
    until(lambda: client.ask("a/x", b"1", 2.0))
    asked = [listener.request("t/busy", bytes([number]), 30.0) for number in range(40)]
    assert client.request("a/x", b"1", 5.0).answer() == b"1"
    assert [request.answer() for request in asked[:37]] == [None] * 37
    for incoming in server.waiting():
        incoming.reply(incoming.payload)
    assert [request.answer() for request in asked[37:]] == [bytes([number]) for number in (37, 38, 39)]


def test_closing_ends_an_asker(pair: tuple[Bus, Bus]) -> None:
    """A thread that waits for an answer is let go when its bus is closed."""
    listener, client = pair
    server = listener.serve("a/x", 8)
    raised = threading.Event()

    def ask() -> None:
        try:
            client.ask("a/x", b"1", 60.0)
        except BusClosedError:
            raised.set()

    thread = threading.Thread(target=ask)
    thread.start()
    time.sleep(0.2)
    client.close()
    thread.join(SECONDS)
    assert raised.is_set()
    assert server.poll() is not None
    with pytest.raises(BusClosedError):
        client.ask("a/x", b"1", 1.0)


def test_a_late_joiner_gets_the_latest_state(pair: tuple[Bus, Bus]) -> None:
    """Only the newest value of a state waits, also for one who subscribes after it was published."""
    listener, client = pair
    publisher = listener.publish_state("s/x")
    for value in (b"1", b"2", b"3"):
        publisher.put(value)
    state = client.subscribe_state("s/x")
    assert until(state.poll).payload == b"3"
    for value in (b"4", b"5", b"6"):
        publisher.put(value)
    newest: list[bytes] = []

    def poll() -> bytes | None:
        newest.extend(sample.payload for sample in state.drain())
        return b"6" if newest and newest[-1] == b"6" else None

    until(poll)


def test_what_is_published_says_when_and_what_it_is(pair: tuple[Bus, Bus], endpoint: Endpoint) -> None:
    """A subscriber of anybody's sees the sender's time and the encoding, of states and of puts."""
    listener, _ = pair
    with zenoh.open(zenoh.Config.from_json5(document(connecting(endpoint, "control")))) as stranger:
        seen = stranger.declare_subscriber("test/**", zenoh.handlers.FifoChannel(16))
        state, put = listener.publish_state("test/state", "text/a"), listener.publish("test/put", "text/b")
        found = {}

        def arrived() -> bool | None:
            state.put(b"")
            put.put(b"")
            while (sample := seen.try_recv()) is not None:
                found[str(sample.key_expr)] = sample.encoding, sample.timestamp.get_time().timestamp()
            return len(found) == 2 or None

        until(arrived)
    assert {key: str(encoding) for key, (encoding, _) in found.items()} == {
        "test/state": "text/a",
        "test/put": "text/b",
    }
    assert all(abs(at - time.time()) < 30.0 for _, at in found.values())


def test_presence_comes_and_goes(pair: tuple[Bus, Bus], endpoint: Endpoint) -> None:
    """A token is seen with its session, also one that was there before, and its end is seen too."""
    listener, _ = pair
    with Bus.connect(endpoint, "control", wait=5.0) as other:
        token = other.announce("l/worker")
        watch = listener.watch("l/*", 8)
        assert until(watch.poll) == Sample("l/worker", b"", b"", True)
        assert token is not None
    assert until(watch.poll).present is False


def test_a_taken_address_and_a_dead_one_are_endpoint_errors() -> None:
    """Both are one clear sentence, raised at once."""
    endpoint = free_endpoint()
    with pytest.raises(EndpointError, match="nobody answers"):
        Bus.connect(endpoint, "control")
    with Bus.listen(endpoint, "control"), pytest.raises(EndpointError, match="in use"):
        Bus.listen(endpoint, "control")


def test_a_listener_that_is_full_is_told_from_none(endpoint: Endpoint, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever comes when all sessions are taken hears that somebody listens."""
    monkeypatch.setattr("eia_sec.common.transport.zenoh_config.MAX_SESSIONS", 1)
    with (
        Bus.listen(endpoint, "control"),
        Bus.connect(endpoint, "control", wait=5.0),
        pytest.raises(EndpointError, match="accepts connections but opens no session"),
    ):
        Bus.connect(endpoint, "control")


def test_a_listener_may_open_as_many_descriptors_as_the_machine_allows(endpoint: Endpoint) -> None:
    """The soft limit, often 1,024, would end at the 500th worker."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (256, hard))
        with Bus.listen(endpoint, "control"):
            assert resource.getrlimit(resource.RLIMIT_NOFILE) == (hard, hard)
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def test_a_process_that_comes_too_early_tries_again_soon() -> None:
    """Several times within one attempt to connect, so that it need not wait for the next one."""
    endpoint, doors = free_endpoint(), 0
    with socket.create_server(("127.0.0.1", endpoint.port)) as door:

        def hang_up() -> None:
            nonlocal doors
            try:
                while True:
                    door.accept()[0].close()
                    doors += 1
            except OSError:
                pass

        host = threading.Thread(target=hang_up, daemon=True)
        host.start()
        with pytest.raises(EndpointError):
            Bus.connect(endpoint, "control", wait=0.0)
        door.shutdown(socket.SHUT_RDWR)
    host.join()
    # One is the attempt's first; one may be ours, which looks why it failed.
    assert doors > 3


@pytest.mark.parametrize("text", ["", "127.0.0.1:7447", "tcp/127.0.0.1", "tcp/127.0.0.1:0", "udp/h:1", "tcp/h:65535"])
def test_malformed_endpoints_are_refused(text: str) -> None:
    """What is no protocol/host:port is an EndpointError."""
    with pytest.raises(EndpointError):
        Endpoint.parse(text)


def test_listening_beyond_this_machine_needs_consent() -> None:
    """An address that others reach is refused unless --insecure was given; a command without it advises otherwise."""
    with pytest.raises(EndpointError, match="insecure"):
        Endpoint.parse("tcp/0.0.0.0:7447").require_private(insecure=False)
    Endpoint.parse("tcp/0.0.0.0:7447").require_private(insecure=True)
    with pytest.raises(EndpointError, match=r"security\.md\), or listen elsewhere\.$"):
        Endpoint.parse("tcp/0.0.0.0:7447").require_private(insecure=False, advice="listen elsewhere")
    for private in ("tcp/127.0.0.1:1", "tcp/localhost:1", "tcp/[::1]:1"):
        Endpoint.parse(private).require_private(insecure=False)


def test_a_flood_does_not_hold_its_reader():
    """As many samples are read at once as may wait, however many come meanwhile."""
    sample = SimpleNamespace(
        key_expr="a/b", attachment=None, kind=zenoh.SampleKind.PUT, payload=SimpleNamespace(to_bytes=lambda: b"x")
    )
    endless = SimpleNamespace(handler=SimpleNamespace(try_recv=lambda: sample))
    assert len(list(Subscription(endless, 5).drain())) == 5


def test_who_is_ended_while_it_waits_for_a_listener_is_not_mistaken():
    """Nobody listens, and the process is asked to end."""
    with pytest.raises(CancelledError, match="before this process was ended"):
        Bus.connect(free_endpoint(), "control", 600.0, waiting=lambda: False)


FULL = "Unable to create POSIX shm segment: OS error 12 at /build/zenoh/commons/zenoh-shm/src/posix_shm/segment.rs:85."
TAKEN = (
    "Can not create a new TCP listener: [127.0.0.1:1: Address already in use (os error 98) at /build/shm.rs:61.] at /x."
)
OTHER = "Can not create a new TCP listener: Too many open files (os error 24) at /build/x.rs:61."


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (FULL, "/dev/shm has no room for shared memory; free some, or leave out --shared-memory"),
        (TAKEN, "the address is in use or does not belong to this machine"),
        (OTHER, "Can not create a new TCP listener: Too many open files (os error 24)"),
    ],
)
def test_why_a_session_cannot_be_opened_is_said(monkeypatch: pytest.MonkeyPatch, text: str, said: str) -> None:
    """Listening names the cause that Zenoh gives; a connection that lacks memory does not blame the other side."""

    def refuse(values: object) -> None:
        raise zenoh.ZError(text)

    monkeypatch.setattr(bus_module, "_open", refuse)
    endpoint = free_endpoint()
    with pytest.raises(EndpointError, match=re.escape(f"cannot listen on {endpoint.locator('bulk')}: {said}.")):
        Bus.listen(endpoint, "bulk")
    if text == FULL:
        with pytest.raises(EndpointError, match=re.escape(f"cannot connect to {endpoint}: {said}.")):
            Bus.connect(endpoint, "bulk")
